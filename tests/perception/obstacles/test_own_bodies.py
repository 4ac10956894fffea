# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.model.team import Team
from skyhaul.perception.obstacles.own_bodies import (
    Bodies,
    blind_cells,
    own_bodies,
    ray_to_segment,
)

from .conftest import state_of


def test_gap_of_ray_and_segment_is_the_least_over_both():
    """Against all pairs of points of a fine grid."""
    rng = np.random.default_rng(0)
    t, s = np.linspace(0.0, 12.0, 1201), np.linspace(0.0, 1.0, 401)
    for k in range(60):
        d, a, e = rng.normal(size=(3, 3)) * [[1.0], [2.0], [1.5]]
        d /= np.linalg.norm(d)
        e = np.zeros(3) if k % 10 == 0 else e
        gap, at = ray_to_segment(*d, *a, *e)
        on_segment = a + s[:, None] * e
        off = np.linalg.norm(on_segment[None] - (t[:, None] * d)[:, None], axis=-1)
        assert gap == pytest.approx(off.min(), abs=0.01)
        assert at >= 0.0


def test_rays_into_a_body_are_blind_and_rays_well_past_it_are_not():
    rng = np.random.default_rng(1)
    c, radius = np.array([1.0, -0.5, 2.0]), 0.2
    body = Bodies(c[None], c[None], np.array([radius]))
    rel = c + radius * 0.99 * _units(rng, 200)
    assert blind_cells(rel / np.linalg.norm(rel, axis=1, keepdims=True), np.zeros(3), body,
                       0.0, 0.0).all()  # fmt: skip
    rays = _units(rng, 2000)
    angle = np.arccos(rays @ c / np.linalg.norm(c))
    reach = np.arcsin(radius / np.linalg.norm(c))
    blind = blind_cells(rays, np.zeros(3), body, 0.0, 0.0)
    assert not blind[angle > 1.01 * reach].any()
    assert blind[angle < 0.99 * reach].all()


def test_margin_and_slack_only_add():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 5, 3)) * 2.0
    body, rays = Bodies(a, b, np.full(5, 0.05)), _units(rng, 2000)
    bare = blind_cells(rays, np.zeros(3), body, 0.0, 0.0)
    for margin, slack in ((0.1, 0.0), (0.0, 0.05)):
        grown = blind_cells(rays, np.zeros(3), body, margin, slack)
        assert np.all(grown[bare])
        assert grown.sum() > bare.sum()


def test_bodies_are_all_of_the_team_but_the_camera_itself():
    team, state = Team(), state_of(Team())
    n = team.count
    bodies = own_bodies(team, state, np.ones(n, np.bool_), 1)
    assert len(bodies.radius) == (n - 1) + 1 + n
    assert not np.any(np.all(bodies.a_W == state.p_WB[1], axis=1))
    lost = np.arange(n) != 2
    assert len(own_bodies(team, state, lost, 1).radius) == len(bodies.radius) - 1


def _units(rng, count):
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
