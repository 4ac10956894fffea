# SPDX-License-Identifier: Apache-2.0
"""References of the tasks that need no map: hover, circle, lying eight, straight legs."""

import math

import numpy as np

from skyhaul.errors import ConfigError
from skyhaul.planning.bspline import ORDER, interpolate
from skyhaul.planning.candidates import ACCEL_SHARE, SPACING_M
from skyhaul.planning.motion import Drive, control_points, run_along
from skyhaul.planning.reference import SMOOTH_RISE, SplineReference
from skyhaul.planning.shortcut import subdivide
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import CircleTask, Figure8Task, HoverTask, Limits

TASK_DT_US = 100_000
"""Knot spacing of the splines through circles and eights [us]."""
LEG_DT_US = 300_000
"""Knot spacing of straight legs [us]."""
LIFT_DT_US = 270_000
"""Knot spacing of a lift-off: the shortest that keeps its jerk within the limit [us]."""


def task_reference(
    task: HoverTask | CircleTask | Figure8Task,
    p_WL: Array,
    yaw_rad: float,
    start_us: TimeUs,
    limits: Limits,
) -> SplineReference:
    """The reference of a task, from rest at a place to rest.

    Circles and eights: the phase runs up over one lap's time, smoothly (its rate is a C6 rise),
    so half a lap is flown meanwhile; then the full laps; then it runs out likewise and ends where
    it began. The spline goes through the analytic curve at every knot.

    Args:
        task: What to fly.
        p_WL: Load's place at the start, (3,) [m].
        yaw_rad: Load's yaw at the start [rad].
        start_us: When it begins [us].
        limits: Checked.

    Raises:
        ConfigError: when the task exceeds the limits.
    """
    start = np.append(p_WL, yaw_rad)
    if isinstance(task, HoverTask):
        pieces = max(1, math.ceil(task.duration_s * US_PER_S / LEG_DT_US))
        return SplineReference(start_us, LEG_DT_US, np.tile(start, (pieces + ORDER - 1, 1)))
    knots = math.ceil((task.laps + 2) * task.period_s * US_PER_S / TASK_DT_US)
    time = np.minimum(np.arange(knots + 1) * TASK_DT_US / US_PER_S, (task.laps + 2) * task.period_s)
    values = start + task_curve(task, phase_at(task, time))
    control = interpolate(values)
    control[:ORDER], control[-ORDER:] = values[0], values[-1]
    reference = SplineReference(start_us, TASK_DT_US, control)
    _check(task, reference, limits)
    return reference


def task_start_us(reference: SplineReference) -> TimeUs:
    """When the phase of a circle or an eight begins to run; before, the reference rests [us]."""
    return reference.start_us + ORDER * TASK_DT_US


def phase_at(task: CircleTask | Figure8Task, time: Array) -> Array:
    """Angle along the lap at times after the phase began to run, (k,) [rad]."""
    up, steady = task.period_s, task.laps * task.period_s
    rate = 2.0 * math.pi / task.period_s
    x = np.clip(time / up, 0.0, 1.0)
    y = np.clip((time - up - steady) / up, 0.0, 1.0)
    even = np.clip(time - up, 0.0, steady)
    return np.asarray(rate * (up * _risen(x) + even + up * (y - _risen(y))))


def _risen(x: Array) -> Array:
    """Integral of the smooth rise from 0 to x."""
    powers = np.arange(8, 15)
    return np.asarray((x[:, None] ** powers) @ (SMOOTH_RISE / powers))


def task_curve(task: CircleTask | Figure8Task, phase: Array) -> Array:
    """Place and yaw on the curve from where it began, (k, 4) [m, rad].

    A circle lies to the west of its start; an eight around it: (a sin, b sin 2, c sin).
    """
    if isinstance(task, CircleTask):
        r = task.radius_m
        flat = [r * (np.cos(phase) - 1.0), r * np.sin(phase), 0.0 * phase, 0.0 * phase]
        return np.column_stack(flat)
    a, b, c = task.size_m
    yaw = math.radians(task.yaw_amplitude_deg)
    s = np.sin(phase)
    return np.column_stack([a * s, b * np.sin(2.0 * phase), c * s, yaw * s])


def _check(task: CircleTask | Figure8Task, reference: SplineReference, limits: Limits) -> None:
    """Refuse what cannot be flown."""
    speed, accel = reference.max_speed_mps(), reference.max_acceleration_mps2()
    if speed > 1.001 * limits.v_max_mps:
        raise ConfigError(
            f"task: the {task.kind} needs {speed:.2f} m/s but limits.v_max_mps = "
            f"{limits.v_max_mps}: make it smaller, lengthen period_s or raise the limit"
        )
    if accel > 1.001 * limits.a_max_mps2:
        raise ConfigError(
            f"task: the {task.kind} needs {accel:.2f} m/s^2 but limits.a_max_mps2 = "
            f"{limits.a_max_mps2}: make it smaller, lengthen period_s or raise the limit"
        )


def leg_reference(
    path: Array, yaw_rad: float, start_us: TimeUs, limits: Limits, dt_us: TimeUs = LEG_DT_US
) -> SplineReference:
    """From rest to rest along straight legs, corners kept sharp; (n, 3) corners [m].

    Lift-off and set-down are the leg between two heights.
    """
    points = subdivide(np.asarray(path, dtype=np.float64), SPACING_M)
    drive = Drive(
        speed=limits.v_max_mps,
        accel=ACCEL_SHARE * limits.a_max_mps2,
        brake=0.0,
        brake_until=0.0,
        rest_at=-1.0,
        rest_s=0.0,
        end_at=math.inf,
    )
    first = np.tile(np.append(points[0], yaw_rad), (ORDER - 1, 1))
    control = control_points(first, run_along(points, 0.0, drive), dt_us / US_PER_S)
    return SplineReference(start_us, dt_us, control)


def lift_reference(
    p_WL: Array, height_m: float, yaw_rad: float, start_us: TimeUs, limits: Limits
) -> SplineReference:
    """Straight up (or down) from a place, (3,), by a height."""
    p = np.asarray(p_WL, dtype=np.float64)
    return leg_reference(
        np.array([p, p + np.array([0.0, 0.0, height_m])]), yaw_rad, start_us, limits, LIFT_DT_US
    )
