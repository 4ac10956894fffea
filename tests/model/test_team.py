# SPDX-License-Identifier: Apache-2.0
"""Tests of `model.team` and `model.envelope`: parameters, formation and the team's shape."""

import numpy as np
import pytest

from skyhaul.geometry.so3 import rotation_z
from skyhaul.model import PointPayload, RigidPayload, Team, Vehicle
from skyhaul.model.envelope import team_shape
from skyhaul.model.team import VehicleOverride


def vehicle_places(team):
    return team.hooks_L() + team.cable_lengths_m()[:, None] * team.formation_dirs_L()


@pytest.mark.parametrize("count", [2, 3, 4, 6, 8])
@pytest.mark.parametrize("payload", [PointPayload(), RigidPayload()])
def test_vehicles_in_formation_keep_their_separation(count, payload):
    team = Team(count=count, payload=payload, cable_length_m=1.5, cable_angle_deg=5.0)
    p = vehicle_places(team)
    gaps = np.linalg.norm(p[:, None] - p[None], axis=-1) + 1e9 * np.eye(count)
    assert gaps.min() >= team.separation_m - 1e-9


@pytest.mark.parametrize("reach_m", [0.05, 0.3])
def test_vehicles_on_hooks_of_any_place_keep_their_separation(reach_m):
    """Hooks that do not stand on the ring: nearer to each other, or farther out."""
    hooks = ((reach_m, 0.05, 0.04), (-0.05, reach_m, 0.04), (-reach_m, -0.1, 0.04), (0.0, -0.2, 0))
    payload = RigidPayload(hook_radius_m=0.7)  # of no use where the hooks are given
    team = Team(
        hooks_m=hooks, azimuths_deg=(20.0, 100.0, 190.0, 275.0), payload=payload, cable_angle_deg=1
    )
    p = vehicle_places(team)
    gaps = np.linalg.norm((p[:, None] - p[None])[..., :2], axis=-1) + 1e9 * np.eye(4)
    assert gaps.min() == pytest.approx(team.separation_m)
    assert team.hook_ring_m == pytest.approx(max(np.hypot(x, y) for x, y, _ in hooks))


def test_cables_lean_outward_by_the_target_angle():
    team = Team(count=3, cable_angle_deg=40.0)
    dirs = team.formation_dirs_L()
    np.testing.assert_allclose(np.degrees(np.arccos(dirs[:, 2])), 40.0)
    assert np.all(np.sum(dirs[:, :2] * team.hooks_L()[:, :2], axis=1) > 0.0)


def test_overrides_reach_the_arrays():
    change = VehicleOverride(index=1, mass_kg=0.4, thrust_max_n=6.0, cable_length_m=1.3)
    a = Team(count=3, overrides=(change,)).arrays()
    np.testing.assert_array_equal(a.m_B, [0.25, 0.4, 0.25])
    np.testing.assert_array_equal(a.thrust_max, [4.24, 6.0, 4.24])
    np.testing.assert_array_equal(a.length, [1.0, 1.3, 1.0])


def test_inertia_of_the_box_is_that_of_its_points():
    size = np.array([0.2, 0.3, 0.1])
    grid = np.linspace(-0.5, 0.5, 41)[:-1] + 0.5 / 40  # centres of 40 cells
    x, y, z = np.meshgrid(*(s * grid for s in size), indexing="ij")
    payload = RigidPayload(mass_kg=2.0, size_m=tuple(size))
    points = [y**2 + z**2, x**2 + z**2, x**2 + y**2]
    np.testing.assert_allclose(payload.J_L, [2.0 * np.mean(r) for r in points], rtol=1e-3)


@pytest.mark.parametrize("count", [1, 3, 4, 8])
@pytest.mark.parametrize("payload", [PointPayload(), RigidPayload()])
def test_shape_of_the_team_holds_it_at_every_yaw(count, payload):
    team = Team(count=count, payload=payload, cable_length_m=1.3)
    shape, v = team_shape(team, margin_m=0.0), team.vehicle
    ring = 2.0 * np.pi * np.arange(24) / 24
    rim = v.radius_m * np.column_stack([np.cos(ring), np.sin(ring), np.zeros(24)])
    heights = np.array([[0.0, 0.0, v.half_height_m], [0.0, 0.0, -v.half_height_m]])
    discs = vehicle_places(team)[:, None, None] + rim[:, None] + heights
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    half = 0.5 * np.array(payload.size_m) if payload.kind == "rigid" else np.zeros(3)
    points = np.vstack([discs.reshape(-1, 3), corners * half, team.hooks_L()])
    for yaw in (0.0, 0.4, 1.3):
        x, y, z = (points @ rotation_z(yaw).T).T
        assert np.hypot(x, y).max() <= shape.radius_m + 1e-12
        assert z.max() <= shape.above_m + 1e-12
        assert -z.min() <= shape.below_m + 1e-12


def test_margin_grows_the_shape_on_every_side():
    bare, wide = team_shape(Team(), 0.0), team_shape(Team(), 0.2)
    for name, value in vars(bare).items():
        assert getattr(wide, name) == pytest.approx(value + 0.2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Vehicle(mass_kg=-0.1), "mass_kg must be > 0, got -0.1"),
        (lambda: Vehicle(thrust_min_n=9.0), "thrust_min_n"),
        (lambda: RigidPayload(mass_kg=0.0), "mass_kg must be > 0"),
        (lambda: Team(count=9), r"count must lie in 1\.\.8, got 9"),
        (lambda: Team(count=8, cable_length_m=0.3), "too short for 8 vehicles"),
        (lambda: Team(count=3, azimuths_deg=(0.0, 90.0)), "azimuths_deg has 2 entries"),
        (lambda: Team(overrides=(VehicleOverride(index=4),)), "index must lie in 0..3"),
    ],
)
def test_impossible_teams_are_refused_in_one_sentence(make, message):
    with pytest.raises(ValueError, match=message):
        make()
