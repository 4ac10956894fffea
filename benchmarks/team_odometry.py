# SPDX-License-Identifier: Apache-2.0
"""Odometry of each vehicle of a recorded flight: exact, with errors of a model, or from files."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from team_recordings import Recording

from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.mission.odometry import ModelledOdometry
from skyhaul.perception.vio.api import NavState, VioEstimate, VioStatus
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.types import US_PER_S, Array, TimeUs

DRIFT_FACTOR = 5.0
"""How much faster the odometry of a drifting vehicle drifts; its covariance says so."""


@lru_cache(maxsize=8)
def places(recording: Recording, vehicle: int) -> Array:
    """True place of a vehicle's IMU at every step, (m, 3) [m]."""
    track, arm = recording.track, recording.config.sensors.imu.calibration().p_BI
    place: Array = track.p_WB[:, vehicle] + quat_rotate(track.q_WB[:, vehicle], arm)
    return place


def drifting(model: ModelledOdometry) -> ModelledOdometry:
    """The same odometry, but it drifts `DRIFT_FACTOR` times as fast."""
    return replace(
        model,
        way_m_per_sqrt_m=DRIFT_FACTOR * model.way_m_per_sqrt_m,
        yaw_deg_per_sqrt_s=DRIFT_FACTOR * model.yaw_deg_per_sqrt_s,
    )


def modelled(
    recording: Recording, vehicle: int, model: ModelledOdometry
) -> Iterator[tuple[TimeUs, VioEstimate]]:
    """What a model makes of the truth, at once."""
    imu, n = recording.config.sensors.imu.calibration(), recording.config.team.count
    memory = model.init(recording.seed, vehicle, n)
    steps = US_PER_S // model.rate_hz // PLANT_STEP_US
    for k in range(steps * vehicle // n, len(recording.track), steps):  # where one is due
        truth = recording.track.truth(k)
        memory, estimate = model.step(memory, truth, imu, recording.bias[1 + vehicle])
        assert estimate is not None
        yield estimate.stamp_us, estimate


def from_file(file: Path) -> Iterator[tuple[TimeUs, VioEstimate]]:
    """Odometry that an estimator wrote into a NumPy archive (`vio_flights.keep_estimates`).

    Rows: `came_us`, when the readings had come that made it, `stamp_us`, `p_WI`, `q_WI`, `v_WI`,
    `gyro_bias`, `accel_bias`, `covariance` (k, 15, 15) of `VioEstimate`, and `tracking` (k,).
    """
    with np.load(file) as rows:
        kept = {name: rows[name] for name in rows.files}
    for k, stamp in enumerate(kept["stamp_us"].tolist()):
        names = ("p_WI", "q_WI", "v_WI", "gyro_bias", "accel_bias")
        status = VioStatus.TRACKING if kept["tracking"][k] else VioStatus.LOST
        state = NavState(*(kept[name][k].copy() for name in names))
        estimate = VioEstimate(stamp, status, state, kept["covariance"][k].copy(), 0, 0)
        yield int(kept["came_us"][k]), estimate
