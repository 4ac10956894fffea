# SPDX-License-Identifier: Apache-2.0
"""Checks across a scenario: what no single class can see."""

import math
from itertools import combinations

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.geometry.shapes import pose_shapes
from skyhaul.geometry.team_clearance import team_clearances
from skyhaul.model.envelope import TeamShape, team_shape
from skyhaul.model.team import Team
from skyhaul.types import Array, Vec3
from skyhaul.world.obstacles import Obstacle
from skyhaul.world.scenario import AirStart, FlyInStart, GoTo, GroundStart, Scenario

GOAL_MARGIN_M = 0.15
"""Room that the team's shape needs on every side at the goal and at the start [m]."""
COLUMN_M = 0.5
"""Height above a ground start within which the team, its cables taut, must touch nothing [m]."""
THRUST_SHARE_MAX = 0.9
"""Largest share of its thrust that a vehicle may need to hover with its part of the load."""
GAP_MAX_DEG = 175.0
"""Widest gap between neighbours around the load: at 180 deg nothing pulls to one side of it."""


def check_scenario(scenario: Scenario) -> None:
    """Refuse a scenario that cannot be flown, whatever the stack does.

    Raises:
        ConfigError: With one sentence that begins with the key at fault.
    """
    _check_team(scenario.team)
    _check_limits(scenario)
    _check_names(scenario.world.obstacles)
    _check_map(scenario)
    if isinstance(scenario.start, AirStart):
        check_place(scenario, "start.payload_m", scenario.start.payload_m)
    else:
        _check_ground(scenario, scenario.start)
    if isinstance(scenario.task, GoTo):
        check_place(scenario, "task.goal_m", scenario.task.goal_m)
    _check_events(scenario)


def hover_thrusts(team: Team) -> Array:
    """Thrust of each vehicle while the team hovers in formation, (n,) [N].

    Every cable carries the same share of the load at the team's cable angle.
    """
    arrays = team.arrays()
    up = arrays.m_L * arrays.g / team.count
    flat = up * math.tan(team.cable_angle_rad)
    return np.hypot(arrays.m_B * arrays.g + up, flat)


def parked_m(team: Team, start: GroundStart | FlyInStart) -> Array:
    """Where the vehicles stand at the start, x and y, (n, 2) [m]."""
    if start.vehicles_m is not None:
        return np.array(start.vehicles_m, dtype=np.float64)
    a, ring = team.azimuths_rad, 0.7 * team.cable_lengths_m()
    flat = np.column_stack([ring * np.cos(a), ring * np.sin(a)])
    return np.asarray(np.array(start.payload_m) + flat)


def clearances_at(shape: TeamShape, p_WL: Array, obstacles: tuple[Obstacle, ...]) -> Array:
    """Signed distance of the team's shape to each obstacle at its own position, (m,) [m].

    Args:
        shape: The team's shape.
        p_WL: Its load's centre of mass, (3,).
        obstacles: The obstacles, m of them.
    """
    posed = pose_shapes([o.shape for o in obstacles], np.array([o.center_m for o in obstacles]))
    size = (shape.radius_m, shape.above_m, shape.below_m)
    p = np.asarray(p_WL, dtype=np.float64)
    return team_clearances(size, p, posed.kind, posed.size, posed.p_WO, posed.R_WO)


def _check_team(team: Team) -> None:
    if team.count < 3:
        raise ConfigError(f"team.count: missions fly 3 to 8 vehicles, got {team.count}")
    need, most = hover_thrusts(team), team.arrays().thrust_max
    i = int(np.argmax(need / most))
    if need[i] > THRUST_SHARE_MAX * most[i]:
        raise ConfigError(
            f"team: vehicle {i} needs {need[i]:.2f} N to hover with its share of the load, more "
            f"than {THRUST_SHARE_MAX:.0%} of its {most[i]:.2f} N; lighten the load or add vehicles"
        )
    _check_gap("team.azimuths_deg", "cables", team.azimuths_rad)
    if team.payload.kind == "rigid":
        hooks = team.hooks_L()
        _check_gap("team.hooks_m", "hooks", np.arctan2(hooks[:, 1], hooks[:, 0]))
        _check_apart(team, hooks[:, :2])


def _check_apart(team: Team, hooks: Array) -> None:
    """Refuse cables that lean across the load or cross each other; hooks x and y, (n, 2) [m].

    Places at the same share of two cables come nearest to each other seen from above.
    """
    out = team.formation_dirs_L()[:, :2]
    i = int(np.argmin(np.sum(hooks * out, axis=1)))
    if hooks[i] @ out[i] < 0.0:
        raise ConfigError(
            f"team.hooks_m: cable {i} would lean across the load from its hook {_point(hooks[i])}; "
            "order hooks_m as team.azimuths_deg, each hook on its vehicle's side"
        )
    reach = team.cable_lengths_m()[:, None] * out
    for i, k in combinations(range(team.count), 2):
        d0, d1 = hooks[i] - hooks[k], reach[i] - reach[k]
        share = min(1.0, max(0.0, -float(d0 @ d1) / max(float(d1 @ d1), 1e-12)))
        if np.linalg.norm(d0 + share * d1) < 0.5 * np.linalg.norm(d0):
            raise ConfigError(
                f"team.hooks_m: cables {i} and {k} would cross between load and vehicles; order "
                "hooks_m as team.azimuths_deg, each hook on its vehicle's side"
            )


def _check_limits(scenario: Scenario) -> None:
    """Refuse a motion of the load that the thrust cannot give.

    With the formation at rest around the load, an acceleration a changes g into g + a in all
    forces: level, as in laps, to sqrt(g^2 + a^2), and straight up, as on the way to a goal, to
    g + a. Braking and drag are level.
    """
    team, limits, arrays = scenario.team, scenario.limits, scenario.team.arrays()
    hover, most = hover_thrusts(team), arrays.thrust_max
    i = int(np.argmax(hover / most))
    share, level = float(hover[i] / most[i]), float(np.sqrt(most[i] ** 2 - hover[i] ** 2))
    drag = team.vehicle.drag_ns_per_m + team.payload.drag_ns_per_m / team.count
    up_mps2, level_mps2 = arrays.g * (1.0 / share - 1.0), arrays.g * level / float(hover[i])
    bounds = {
        "v_max_mps": (level / drag if drag > 0.0 else math.inf, "m/s"),
        "a_max_mps2": (up_mps2 if isinstance(scenario.task, GoTo) else level_mps2, "m/s^2"),
        "a_brake_mps2": (level_mps2, "m/s^2"),
    }
    for name, (bound, unit) in bounds.items():
        wanted = getattr(limits, name)
        if wanted > bound:
            raise ConfigError(
                f"limits.{name}: must be <= {bound:.2f} {unit}, got {wanted}: vehicle {i} needs "
                f"{share:.0%} of its thrust to hover, and the rest gives no more"
            )


def _check_gap(key: str, what: str, azimuths_rad: Array) -> None:
    """Refuse a load that hangs over its edge: all cables or hooks, (n,), on one side of it."""
    a = np.sort(np.mod(azimuths_rad, 2.0 * math.pi))
    gap_deg = math.degrees(float(np.max(np.diff(a, append=a[0] + 2.0 * math.pi))))
    if gap_deg > GAP_MAX_DEG:
        raise ConfigError(
            f"{key}: the {what} leave {gap_deg:.0f} deg around the load free, more than "
            f"{GAP_MAX_DEG:.0f} deg, so that it cannot hang level; spread them around it"
        )


def _check_names(obstacles: tuple[Obstacle, ...]) -> None:
    for (i, a), (j, b) in combinations(enumerate(obstacles), 2):
        if a.name == b.name:
            raise ConfigError(
                f"world.obstacles[{j}].name: {b.name!r} is the name of obstacle {i} already"
            )


def _check_map(scenario: Scenario) -> None:
    low, high = map_box(scenario)
    if np.any(high - low <= 0.0):
        raise ConfigError("world.map: the map and the room do not overlap")


def map_box(scenario: Scenario) -> tuple[Array, Array]:
    """Smallest and largest corner of what is both map and room, (3,) each [m]."""
    frame, room = scenario.world.map, scenario.world.room
    origin = np.array(frame.origin_m)
    low = np.maximum(origin, room.min_m)
    return low, np.minimum(origin + frame.size_m, room.max_m)


def check_place(scenario: Scenario, key: str, place: Vec3 | Array) -> None:
    """The team's shape fits at a place of the load, clear of walls and of what stands.

    Args:
        scenario: Team, map, room and obstacles.
        key: What the place is of, in the sentence.
        place: Load's centre of mass, (3,) [m].

    Raises:
        ConfigError: When it does not.
    """
    shape, p = team_shape(scenario.team, GOAL_MARGIN_M), np.array(place)
    low, high = map_box(scenario)
    if np.any(p < low) or np.any(p > high):
        raise ConfigError(
            f"{key}: {_point(p)} lies outside the map, {_point(low)} to {_point(high)} m"
        )
    low = low + np.array([shape.radius_m, shape.radius_m, shape.below_m])
    high = high - np.array([shape.radius_m, shape.radius_m, shape.above_m])
    if np.any(p < low) or np.any(p > high):
        raise ConfigError(
            f"{key}: at {_point(p)} the team does not fit between the walls; the load must be "
            f"within {_point(low)} to {_point(high)} m"
        )
    obstacles = standing(scenario)
    for o, gap in zip(obstacles, clearances_at(shape, p, obstacles), strict=True):
        if gap <= 0.0:
            raise ConfigError(
                f"{key}: at {_point(p)} the team, {shape.radius_m:.2f} m around the load, would "
                f"touch obstacle {o.name!r}; move it away{_free_height(scenario, shape, p)}"
            )


def standing(scenario: Scenario) -> tuple[Obstacle, ...]:
    """Obstacles that stand still and are there from the start."""
    obstacles = scenario.world.obstacles
    return tuple(o for o in obstacles if o.motion.kind == "static" and o.appears is None)


def _free_height(scenario: Scenario, shape: TeamShape, p: Array) -> str:
    """Where the team would fit straight above or below a place, as part of a sentence."""
    low, high = map_box(scenario)
    heights = np.arange(low[2] + shape.below_m, high[2] - shape.above_m, 0.05)
    for z in sorted(heights, key=lambda z: float(abs(z - p[2]))):
        at = np.array([p[0], p[1], z])
        if np.min(clearances_at(shape, at, standing(scenario)), initial=1.0) > 0.0:
            return f", for example to height {z:.2f} m"
    return ""


def _check_ground(scenario: Scenario, start: GroundStart | FlyInStart) -> None:
    team, spots = scenario.team, parked_m(scenario.team, start)
    if len(spots) != team.count:
        raise ConfigError(
            f"start.vehicles_m: {len(spots)} places for {team.count} vehicles; give one each"
        )
    low, high = map_box(scenario)
    for i, spot in enumerate(spots):
        if np.any(spot < low[:2]) or np.any(spot > high[:2]):
            raise ConfigError(
                f"start.vehicles_m[{i}]: {_point(spot)} lies outside the map, "
                f"{_point(low[:2])} to {_point(high[:2])} m"
            )
    load = np.array(start.payload_m)
    if np.any(load < low[:2]) or np.any(load > high[:2]):
        raise ConfigError(f"start.payload_m: {_point(load)} lies outside the map")
    room = 2.0 * team.vehicle.radius_m
    for i, j in combinations(range(team.count), 2):
        gap = float(np.linalg.norm(spots[i] - spots[j]))
        if gap < room:
            raise ConfigError(
                f"start.vehicles_m: vehicles {i} and {j} stand {gap:.2f} m apart; "
                f"their bodies need {room:.2f} m"
            )
    if isinstance(start, GroundStart):
        _check_cables(team, load, spots)
    _check_column(scenario, load)


def _check_column(scenario: Scenario, load: Array) -> None:
    """The team can rise straight up: there is no way to step aside while the floor holds the load.

    Movers do not count: the team waits for them.
    """
    shape, rest = team_shape(scenario.team, GOAL_MARGIN_M), rest_height_m(scenario.team)
    low, high = map_box(scenario)
    reach = np.array([shape.radius_m, shape.radius_m])
    if np.any(load - reach < low[:2]) or np.any(load + reach > high[:2]):
        raise ConfigError(
            f"start.payload_m: at {_point(load)} the team, {shape.radius_m:.2f} m around the load, "
            f"does not fit between the walls; the load must stand within {_point(low[:2] + reach)} "
            f"to {_point(high[:2] - reach)} m"
        )
    obstacles = standing(scenario)
    for z in np.arange(rest, rest + COLUMN_M + 0.025, 0.05):
        gaps = clearances_at(shape, np.array([load[0], load[1], z]), obstacles)
        for o, gap in zip(obstacles, gaps, strict=True):
            if gap <= 0.0:
                raise ConfigError(
                    f"start.payload_m: over {_point(load)} the team, {shape.radius_m:.2f} m around "
                    f"the load, would touch obstacle {o.name!r} as it takes off; move one of them"
                )


def rest_height_m(team: Team) -> float:
    """Height of the load's centre of mass where it stands on the floor [m]."""
    payload = team.payload
    return 0.5 * payload.size_m[2] if payload.kind == "rigid" else payload.radius_m


def _check_cables(team: Team, load: Array, spots: Array) -> None:
    """Every cable reaches from its hook on the standing load to its parked vehicle."""
    hooks = team.hooks_L() + np.array([load[0], load[1], rest_height_m(team)])
    centres = np.column_stack([spots, np.full(team.count, team.vehicle.half_height_m)])
    need, length = np.linalg.norm(centres - hooks, axis=1), team.cable_lengths_m()
    for i in range(team.count):
        if need[i] > length[i]:
            raise ConfigError(
                f"start.vehicles_m[{i}]: vehicle {i} stands {need[i]:.2f} m from its hook, its "
                f"cable is {length[i]:.2f} m long; move it nearer or lengthen team.cable_length_m"
            )


def _check_events(scenario: Scenario) -> None:
    for i, event in enumerate(scenario.events):
        if not 0 <= event.vehicle < scenario.team.count:
            raise ConfigError(
                f"events[{i}].vehicle: there is no vehicle {event.vehicle}; "
                f"allowed: 0 to {scenario.team.count - 1}"
            )
        progress = event.kind == "vehicle-dies" and event.at_progress is not None
        if progress and not isinstance(scenario.task, GoTo):
            raise ConfigError(
                f"events[{i}].at_progress: only a task with a goal has progress, got task kind "
                f"{scenario.task.kind!r}; give at_s"
            )


def _point(p: Array) -> str:
    return "(" + ", ".join(f"{c:.2f}".rstrip("0").rstrip(".") for c in p) + ")"
