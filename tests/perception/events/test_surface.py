# SPDX-License-Identifier: Apache-2.0
"""What a node starts with, against scenes whose motion is known in closed form."""

import numpy as np
import pytest

from skyhaul.geometry.camera import Equidistant, RadTan, project_points
from skyhaul.geometry.so3 import so3_exp
from skyhaul.perception.events.classifier import EventNetwork
from skyhaul.perception.events.graph import GraphParams, event_graph
from skyhaul.perception.events.lens import event_lens
from skyhaul.perception.events.surface import fitted_plane, no_surface
from skyhaul.perception.events.weights import shipped_weights
from skyhaul.sensors.api import EventReading

SIZE = (60, 50)
LENS = event_lens(RadTan.from_fov(SIZE, 60.0))
GRAPH = GraphParams(max_neighbours=24, refractory_us=0)
STEP_US = 500


def sweep(edge_at, lens=LENS, until_us=200_000):
    """Events where the sign of a function of pixel and time changes, one stamp per step."""
    v, u = np.mgrid[: lens.height, : lens.width]
    before, rows = edge_at(u, v, 0.0) > 0.0, []
    for t in range(STEP_US, until_us, STEP_US):
        now = edge_at(u, v, 1e-6 * t) > 0.0
        y, x = np.nonzero(now != before)
        rows.append(np.column_stack([np.full(len(x), t), x, y, np.where(now[y, x], 1, -1)]))
        before = now
    t, x, y, p = np.concatenate(rows).T
    return EventReading(t, x.astype(np.int16), y.astype(np.int16), p.astype(np.int8))


def late(events, margin=6):
    """Events far from the border after the beginning, where all neighbours are there."""
    inside = (events.x >= margin) & (events.x < SIZE[0] - margin)
    inside &= (events.y >= margin) & (events.y < SIZE[1] - margin)
    return inside & (events.t_us > 60_000)


@pytest.mark.parametrize("angle_deg", [0.0, 40.0, 90.0, 200.0])
@pytest.mark.parametrize("speed", [40.0, 150.0])
def test_direction_and_speed_of_a_moving_edge(angle_deg, speed):
    a = np.deg2rad(angle_deg)
    n = np.array([np.cos(a), np.sin(a)])
    start = min(0.0, n[0] * SIZE[0]) + min(0.0, n[1] * SIZE[1])
    events = sweep(lambda u, v, t: start + speed * t - n[0] * u - n[1] * v, until_us=400_000)
    found = event_graph(GRAPH, LENS, events, np.zeros((len(events.t_us), 3))).inputs[late(events)]
    direction = np.median(found[:, 4:6], axis=0)
    np.testing.assert_allclose(direction / np.linalg.norm(direction), n, atol=0.1)
    squeezed = np.median(found[:, 6])
    measured = 30.0 * squeezed / (1.0 - squeezed)
    assert measured == pytest.approx(speed, rel=0.25)


def walls(lens, turn_rate_C, v_C, range_m, period_m=2.0):
    """Stripes on a sphere of this radius around the camera's first place; it turns and moves."""
    rays = lens.rays_C

    def edge(u, v, t):
        p = t * np.asarray(v_C)
        R = so3_exp(t * np.asarray(turn_rate_C))
        f = rays @ R.T
        along = f @ p
        far = -along + np.sqrt(along**2 - p @ p + range_m**2)
        place = far[..., None] * f + p
        return np.sin(2.0 * np.pi * place[..., 0] / period_m + 0.3)

    return edge


def test_range_of_what_stands_is_that_of_the_scene_while_the_camera_turns_and_moves():
    rate, v_C, range_m = np.array([0.0, 0.35, 0.1]), np.array([0.9, 0.1, 0.0]), 2.5
    events = sweep(walls(LENS, rate, v_C, range_m, 1.5))
    t_s = 1e-6 * events.t_us[:, None]
    # the velocity in the axes of the turned camera
    v_now = np.einsum("kji,j->ki", so3_exp(t_s * rate), v_C)
    found = event_graph(GRAPH, LENS, events, t_s * rate, v_now).inputs[late(events)]
    squeezed = np.median(found[:, 9])
    assert squeezed / (1.0 - squeezed) == pytest.approx(range_m, rel=0.3)
    # in what moves as fast the other way it is none
    turned = event_graph(GRAPH, LENS, events, t_s * rate, -v_now).inputs[late(events)]
    assert np.median(turned[:, 9]) < 0.0


def test_a_camera_that_only_turns_explains_all_speed_by_its_turn():
    rate = np.array([0.1, -0.9, 0.3])
    events = sweep(walls(LENS, rate, np.zeros(3), 4.0))
    found = event_graph(GRAPH, LENS, events, 1e-6 * events.t_us[:, None] * rate).inputs
    found = found[late(events)]
    speed, turning = (np.median(found[:, c]) for c in (6, 7))
    assert turning == pytest.approx(speed, abs=0.06)
    assert np.all(found[:, 9] == 0.0)


@pytest.mark.parametrize(
    "lens", [LENS, event_lens(Equidistant.from_fov((40, 30), 140.0))], ids=["pinhole", "fisheye"]
)
def test_move_flow_is_the_derivative_of_the_image_of_a_point(lens):
    rng, v_C, range_m, dt = np.random.default_rng(1), np.array([0.4, -0.7, 0.5]), 3.0, 1e-5
    for _ in range(20):
        y, x = rng.integers(lens.height), rng.integers(lens.width)
        point = range_m * lens.rays_C[y, x]
        ahead, _ = project_points(lens.model, np.stack([point - dt * v_C, point + dt * v_C]))
        wanted = (ahead[0] - ahead[1]) / (2.0 * dt)
        np.testing.assert_allclose(lens.move_flow[y, x] @ v_C / range_m, wanted, atol=2e-2)


def test_plane_is_that_of_least_squares_when_all_lie_on_it():
    rng, surface, g = np.random.default_rng(0), no_surface(12), np.array([0.004, -0.007])
    surface.dx[:], surface.dy[:] = rng.integers(-3, 4, (2, 12))
    surface.dt[:] = g[0] * surface.dx + g[1] * surface.dy
    d = np.column_stack([surface.dx, surface.dy])
    plane = fitted_plane(12, surface)
    wanted = np.linalg.solve(d.T @ d + np.eye(2), d.T @ surface.dt)
    np.testing.assert_allclose([plane.gx, plane.gy], wanted, rtol=0.05)
    np.testing.assert_allclose([plane.gx, plane.gy], g, rtol=0.1)


def test_one_that_lies_far_off_the_plane_counts_little():
    surface = no_surface(9)
    surface.dx[:], surface.dy[:] = np.repeat([-1, 0, 1], 3), np.tile([-1, 0, 1], 3)
    surface.dt[:] = 0.01 * surface.dx
    clean = fitted_plane(9, surface)
    surface.dt[0] += 0.09
    pulled = fitted_plane(9, surface)
    d = np.column_stack([surface.dx, surface.dy])
    plain = np.linalg.solve(d.T @ d + np.eye(2), d.T @ surface.dt)
    assert abs(pulled.gx - clean.gx) < 0.5 * abs(plain[0] - clean.gx)


def test_the_shipped_network_tells_a_flying_disc_from_walls_that_pass():
    """A camera flies by striped walls; a dark disc crosses the other way, faster than they do.

    Far from what it was trained on, so that it is asked to rank, not to be sure.
    """
    lens = event_lens(Equidistant.from_fov((80, 60), 90.0))
    rate, v_C, radius = np.array([0.05, 0.15, 0.0]), np.array([0.8, 0.0, 0.2]), 5.0
    wall = walls(lens, rate, v_C, 3.0, 0.8)

    def middle(t):
        return np.array([20.0 + 90.0 * t, 25.0 + 30.0 * t])

    def edge(u, v, t):
        inside = np.hypot(u - middle(t)[0], v - middle(t)[1]) < radius
        return np.where(inside, -2.0, wall(u, v, t))

    events = sweep(edge, lens, 400_000)
    t_s = 1e-6 * events.t_us[:, None]
    v_now = np.einsum("kji,j->ki", so3_exp(t_s * rate), v_C)
    network = EventNetwork(shipped_weights())
    _, scores = network.step(network.init(lens), events, t_s * rate, v_now)
    x, y = middle(t_s[:, 0])
    of_disc = np.abs(np.hypot(events.x - x, events.y - y) - radius) < 1.5
    warm = events.t_us > 150_000
    disc = scores.p_mover[warm & of_disc].mean()
    wall_events = scores.p_mover[warm & ~of_disc].mean()
    assert disc > 4.0 * wall_events, (disc, wall_events)
    assert scores.mover[warm & ~of_disc].mean() < 0.05
