# SPDX-License-Identifier: Apache-2.0
"""Whether the take-off, as it will go from now on, is clear of movers."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.mapping.api import WorldMap
from skyhaul.mapping.clearance import tube_clearances
from skyhaul.mission.setup import Stack
from skyhaul.mission.station import minimum_jerk, route_along, station_point
from skyhaul.types import Array, TimeUs

STEP_S = 0.1
"""Spacing of the times that are looked at [s]."""
ALONG_CABLE = (0.35, 0.7)
"""Shares of a cable, from its hook, at which it is looked at."""


class TakeOff(NamedTuple):
    """Where everything will be at k times from now on."""

    ahead_s: Array  # (k,) times from now [s]
    p_WB: Array  # (k, n, 3) vehicles [m]
    p_WC: Array  # (k, n * c, 3) places on the cables [m]
    p_WL: Array  # (k, 3) load [m]
    rises: int  # the load rises from this time on


def predict(stack: Stack, p_WP: Array, load: Array, left_s: Array) -> TakeOff:
    """The take-off from now on: to the stations, tauten, spool, straight up.

    Args:
        stack: The stack.
        p_WP: Where each vehicle was parked, (n, 3) [m].
        load: Load state, (13,).
        left_s: Time until each vehicle is at its station, (n,) [s]; inf: it stands parked.
    """
    params, R_WL, n = stack.mission.take_off, quat_to_R(load[3:7]), stack.team.count
    stations = np.array([station_point(stack.team, load[:3], R_WL, i, 1.0) for i in range(n)])
    ways = [route_along(np.array([p_WP[i], stations[i]])) for i in range(n)]
    whole_s = np.array([stack.mission.station.duration_s(way) for way in ways])
    left_s = np.minimum(left_s, whole_s)
    at_s = float(left_s.max()) + params.tauten_s + stack.mission.spool_s + params.rise_s
    ahead_s = np.arange(0.0, at_s + params.dodge_s + STEP_S, STEP_S)
    done = np.clip(1.0 - (left_s - ahead_s[:, None]) / whole_s, 0.0, 1.0)
    share = minimum_jerk(done)[:, :, None]
    up = np.zeros((len(ahead_s), 3))
    up[:, 2] = 0.5 * stack.limits.a_max_mps2 * np.maximum(ahead_s - at_s, 0.0) ** 2
    p_WB = p_WP + share * (stations - p_WP) + up[:, None]
    hooks = load[:3] + stack.team.hooks_L() @ R_WL.T + up[:, None]
    cables = [hooks + s * (p_WB - hooks) for s in ALONG_CABLE]
    return TakeOff(ahead_s, p_WB, np.concatenate(cables, axis=1), load[:3] + up, int(at_s / STEP_S))


def is_clear(stack: Stack, world_map: WorldMap, t_us: TimeUs, take_off: TakeOff) -> bool:
    """Whether no mover comes too near to any body on the way, nor to the team while it rises.

    On the way every vehicle and cable counts by itself: a mover may pass beside them, inside the
    team's shape. Once the team rises, its shape is what the planner goes by: a mover in it must
    not come closer than it is then.
    """
    vehicle, params = stack.team.vehicle, stack.mission.take_off
    high = vehicle.half_height_m + params.margin_m
    body = np.array([vehicle.radius_m + params.margin_m, high, high])
    thin = np.array([params.margin_m, high, high])
    after_s = float(world_map.after_s(np.array([t_us]))[0]) + take_off.ahead_s
    for p, shape in ((take_off.p_WB, body), (take_off.p_WC, thin)):
        count = p.shape[1]
        arrays = world_map.arrays._replace(shape=shape)
        if np.min(tube_clearances(arrays, p.reshape(-1, 3), np.repeat(after_s, count))) < 0.0:
            return False
    rise = slice(take_off.rises, None)
    team = tube_clearances(world_map.arrays, take_off.p_WL[rise], after_s[rise])
    return bool(np.min(team) >= min(team[0], 0.0) - params.closer_m)


def without_statics(world_map: WorldMap) -> WorldMap:
    """The map with its tracks alone, for a load that stands on the floor and cannot step aside."""
    open_space = np.full_like(world_map.static_clearance, world_map.truncation_m)
    room = np.full(3, np.inf)
    return replace(
        world_map, static_clearance=open_space, coarse=None, room_min=-room, room_max=room
    )
