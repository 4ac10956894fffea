# SPDX-License-Identifier: Apache-2.0
"""What the mapper reports as changed, and that its map is that of what it was told last."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.geometry.shapes import Box, Sphere
from skyhaul.mapping.api import OccupancyGrid
from skyhaul.mapping.mapper import Mapping, static_map
from skyhaul.mapping.tubes import has_strayed, track_arrays
from skyhaul.model.envelope import TeamShape
from skyhaul.model.state import TeamState
from skyhaul.perception.api import ObstacleEstimate, StandingVoxels, StaticObject, Track
from skyhaul.world.scenario import MapFrame, Room

SHAPE = TeamShape(radius_m=0.5, above_m=0.8, below_m=0.2)
FRAME = MapFrame(origin_m=(-1.0, -1.0, 0.0), size_m=(7.0, 7.0, 5.0))
MAPPER = Mapping().build(FRAME, Room(min_m=(-1, -1, 0), max_m=(6, 6, 5)), SHAPE)


def team_at(p_WL=(0.5, 0.5, 1.0)) -> TeamState:
    z = np.zeros
    return TeamState(
        np.array(p_WL, np.float64), np.array([1.0, 0, 0, 0]), z(3), z(3),
        z((4, 3)), z((4, 4)), z((4, 3)), z((4, 3)),
    )  # fmt: skip


def cube(i, p, edge=0.4) -> StaticObject:
    return StaticObject(i, Box(size_m=(edge,) * 3), np.array(p, np.float64), np.eye(3))


def track(i, p, v=(0.0, 0.0, 0.0), stamp_us=0) -> Track:
    return Track(
        i, stamp_us, Sphere(radius_m=0.2), np.array(p, np.float64), np.eye(3),
        np.array(v, np.float64), np.zeros((6, 6)), 0.1, 0.05,
    )  # fmt: skip


def fly(*estimates, mapper=MAPPER, team=None):
    memory, out = mapper.init(), []
    for e in estimates:
        memory, world_map, change = mapper.step(memory, e, team or team_at())
        out.append((world_map, change))
    return out


def seen(*statics, tracks=(), stamp_us=0) -> ObstacleEstimate:
    return ObstacleEstimate(stamp_us, statics, tuple(tracks))


def test_maps_built_step_by_step_equal_a_map_built_at_once():
    a, b, c = cube(0, (2, 2, 2)), cube(1, (3.03, 4, 1)), cube(2, (4.5, 1, 3.3), 0.6)
    moved = cube(1, (1.0, 4.2, 3))
    steps = fly(seen(a), seen(a, b), seen(a, b, c), seen(a, moved, c), seen(moved, c))
    (at_once, _), (last, _) = fly(seen(moved, c))[0], steps[-1]
    np.testing.assert_array_equal(last.grid.occupied, at_once.grid.occupied)
    np.testing.assert_array_equal(last.static_clearance, at_once.static_clearance)
    whole = static_map(last.grid, SHAPE)
    np.testing.assert_array_equal(last.static_clearance, whole.static_clearance)


def voxels(version, low, high, *boxes):
    """Voxels that were seen: ranges that are occupied, and the range that changed."""
    grid = MAPPER.step(MAPPER.init(), seen(), team_at())[1].grid
    occupied = np.zeros(grid.occupied.shape, bool)
    for a, b in boxes:
        occupied[tuple(slice(i, j) for i, j in zip(a, b, strict=True))] = True
    return StandingVoxels(
        occupied, grid.p_WO.copy(), grid.voxel_m, version, np.array([low, high], np.int64)
    )


def test_voxels_that_are_seen_give_the_map_of_a_map_built_at_once():
    a, b = ((10, 10, 10), (14, 14, 14)), ((40, 20, 30), (43, 24, 31))
    first = voxels(1, *a, a)
    second = voxels(2, (10, 10, 10), (43, 24, 31), b)
    third = voxels(3, *a, a, b)
    steps = fly(*(ObstacleEstimate(0, (), (), v) for v in (first, second, second, third)))
    last, whole = steps[-1][0], static_map(OccupancyGrid(third.occupied, *_frame(third)), SHAPE)
    np.testing.assert_array_equal(last.grid.occupied, third.occupied)
    np.testing.assert_array_equal(last.static_clearance, whole.static_clearance)
    assert [c.static_changed for _, c in steps] == [True, True, False, True]
    np.testing.assert_allclose(
        steps[-1][1].changed_min, third.p_WO + 0.1 * np.array(a[0]) - 0.05, atol=1e-9
    )
    np.testing.assert_allclose(
        steps[-1][1].changed_max, third.p_WO + 0.1 * np.array(a[1]) - 0.05, atol=1e-9
    )


def test_a_version_that_was_missed_costs_a_whole_field_and_no_error():
    a, b = ((10, 10, 10), (14, 14, 14)), ((40, 20, 30), (43, 24, 31))
    last = voxels(7, *b, a, b)
    ((m, _),) = fly(ObstacleEstimate(0, (), (), last))
    whole = static_map(OccupancyGrid(last.occupied, *_frame(last)), SHAPE)
    np.testing.assert_array_equal(m.static_clearance, whole.static_clearance)


def test_voxels_of_another_map_are_refused():
    v = voxels(1, (0, 0, 0), (1, 1, 1))
    wrong = replace(v, p_WO=v.p_WO + 0.03)
    with pytest.raises(ValueError, match="those of the map"):
        fly(ObstacleEstimate(0, (), (), wrong))


def _frame(v):
    return v.p_WO, v.voxel_m


def test_a_static_change_tells_where_and_raises_the_version():
    a, b = cube(0, (2, 2, 2)), cube(1, (3, 4, 1))
    (m0, first), (m1, none), (m2, added) = fly(seen(a), seen(a), seen(a, b))
    assert first.static_changed
    assert not none.static_changed
    assert m1.version == m0.version < m2.version
    np.testing.assert_allclose(added.changed_min, [2.8, 3.8, 0.8])
    np.testing.assert_allclose(added.changed_max, [3.2, 4.2, 1.2])


def test_a_static_object_that_begins_to_move_leaves_no_ghost():
    (_, _), (m, change) = fly(seen(cube(0, (2, 2, 2))), seen(tracks=[track(0, (2, 2, 2))]))
    assert not m.grid.occupied.any()
    assert change.static_changed
    assert change.born == (0,)


def test_births_and_deaths_of_tracks_are_reported_once():
    a, b = track(7, (2, 2, 2)), track(9, (3, 3, 3))
    changes = [c for _, c in fly(seen(), seen(tracks=[a]), seen(tracks=[a, b]), seen(tracks=[b]))]
    assert [c.born for c in changes] == [(), (7,), (9,), ()]
    assert [c.died for c in changes] == [(), (), (), (7,)]


def test_a_track_that_turns_away_strays_once_until_it_strays_again():
    straight = [track(1, (1 + 0.5 * k / 10, 2, 2), (0.5, 0, 0), 100_000 * k) for k in range(5)]
    turned = [track(1, (1.2, 2 + 0.5 * k / 10, 2), (0, 0.5, 0), 400_000 + 100_000 * k)
              for k in range(1, 9)]  # fmt: skip
    tracks = straight + turned
    changes = [c for _, c in fly(*(seen(tracks=[t], stamp_us=t.stamp_us) for t in tracks))]
    assert not any(c.strayed for c in changes[:5])
    assert sum(c.strayed == (1,) for c in changes[5:]) == 1


def test_marking_a_plan_moves_the_tubes_to_now():
    old, new = track(1, (1, 2, 2), (0.5, 0, 0)), track(1, (1.0, 2.1, 2), (0, 0.5, 0), 200_000)
    memory, *_ = MAPPER.step(MAPPER.init(), seen(tracks=[old]), team_at())
    memory, _, change = MAPPER.step(memory, seen(tracks=[new], stamp_us=200_000), team_at())
    assert change.strayed == (1,)
    memory = MAPPER.mark_planned(memory)
    later = replace(new, p_WO=new.p_WO + 0.5 * new.v_WO, stamp_us=700_000)
    assert MAPPER.step(memory, seen(tracks=[later]), team_at())[2].strayed == ()


def test_a_track_strays_when_it_is_out_of_its_tube():
    before = track(1, (0, 0, 0), (1, 0, 0))
    inside, outside = (track(1, (1, y, 0), (1, 0, 0), 1_000_000) for y in (0.149, 0.151))
    assert not has_strayed(before, inside)
    assert has_strayed(before, outside)


def test_tracks_are_brought_to_one_time():
    rows = track_arrays((track(1, (0, 0, 0), (1, 2, 3), 500_000),), 1_500_000)
    np.testing.assert_allclose(rows.p_WO, [[1, 2, 3]])
    np.testing.assert_allclose(rows.tube_base, [0.15])


def test_a_step_leaves_the_memory_it_was_given_alone():
    memory, *_ = MAPPER.step(MAPPER.init(), seen(cube(0, (2, 2, 2))), team_at())
    before = memory.fine.clearance.copy()
    MAPPER.step(memory, seen(cube(0, (2, 2, 2)), cube(1, (3, 3, 3))), team_at())
    np.testing.assert_array_equal(memory.fine.clearance, before)


WINDOW = Mapping(window_shift_m=0.5).build(
    replace(FRAME, window_m=(3.0, 3.0, 3.0), coarse_voxel_m=0.5), MAPPER.room, SHAPE
)


def test_the_window_follows_the_load_and_stays_on_whole_voxels_inside_the_map():
    memory, first, _ = WINDOW.step(WINDOW.init(), seen(), team_at((0.5, 0.5, 1.0)))
    memory, same, _ = WINDOW.step(memory, seen(), team_at((0.8, 0.5, 1.0)))
    memory, moved, _ = WINDOW.step(memory, seen(), team_at((3.07, 2.0, 1.0)))
    assert first.grid.occupied.shape == (30, 30, 30)
    np.testing.assert_array_equal(first.grid.p_WO, same.grid.p_WO)
    np.testing.assert_allclose(moved.grid.p_WO - 0.05, [1.5, 0.5, 0.0], atol=1e-9)


def test_what_was_seen_stands_in_the_window_that_rolls_over_it():
    objects = (cube(0, (4.5, 4.5, 2.0)),)
    memory, _, _ = WINDOW.step(WINDOW.init(), seen(*objects), team_at((0.5, 0.5, 1.0)))
    _, rolled, _ = WINDOW.step(memory, seen(*objects), team_at((4.0, 4.0, 2.0)))
    assert rolled.grid.occupied.sum() == 4**3
    fresh = WINDOW.step(WINDOW.init(), seen(*objects), team_at((4.0, 4.0, 2.0)))[1]
    np.testing.assert_array_equal(rolled.static_clearance, fresh.static_clearance)


@pytest.mark.parametrize(
    ("name", "value"), [("truncation_m", 1.0), ("tube_horizon_s", 0.0), ("exempt_m", -0.1)]
)
def test_parameters_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} must be .* got"):
        Mapping(**{name: value})
