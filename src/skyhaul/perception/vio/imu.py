# SPDX-License-Identifier: Apache-2.0
"""IMU samples between two times, the noise of an IMU, and how a state moves through them."""

from dataclasses import dataclass, replace

import numpy as np

from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.params import Params
from skyhaul.perception.vio.api import NE, NavState
from skyhaul.perception.vio.propagation import propagate
from skyhaul.perception.vio.screening import blind_s2
from skyhaul.sensors.api import ImuReading
from skyhaul.types import GRAVITY_MPS2, US_PER_S, Array, TimeUs

GRAVITY_W = np.array([0.0, 0.0, -GRAVITY_MPS2])
GRAVITY_W.setflags(write=False)
BLIND_RAD_S, BLIND_MPS2 = 1.0, 5.0
"""How far rate and force in a gap may be from the line between its ends."""
SPELL_S = 2.0
"""How long a turn or a push of a vehicle lasts, about [s]."""


@dataclass(frozen=True, kw_only=True)
class ImuNoise(Params):
    """Noise that the estimators assume of an IMU; the defaults bear vibration of rotors."""

    gyro_rad_s_rthz: float = 3.4e-4
    """White noise of the gyroscope [rad/s/sqrt(Hz)]."""
    accel_mps2_rthz: float = 4e-3
    """White noise of the accelerometer [m/s^2/sqrt(Hz)]."""
    gyro_walk_rad_s2_rthz: float = 2e-5
    """Random walk of the gyroscope's bias [rad/s^2/sqrt(Hz)]."""
    accel_walk_mps3_rthz: float = 3e-3
    """Random walk of the accelerometer's bias [m/s^3/sqrt(Hz)]."""
    scale_error: float = 0.0
    """What calibration left of errors of scale and axes, as a share of rate and force."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (value > 0.0 or (name == "scale_error" and value == 0.0)):
                raise ValueError(f"{name} must be > 0, got {value}")

    def densities(self) -> Array:
        """The four, in the order that `propagate` takes."""
        return np.array(
            [
                self.gyro_rad_s_rthz,
                self.accel_mps2_rthz,
                self.gyro_walk_rad_s2_rthz,
                self.accel_walk_mps3_rthz,
            ]
        )

    def through_gaps(self, imu: ImuReading, from_us: TimeUs, to_us: TimeUs) -> "ImuNoise":
        """The same with what nobody measured: unknown turns and pushes while samples are missing.

        A rate that is unknown by sigma, but lasts, has turned by sigma t at a time t into a gap:
        from a to b into it the variance grows by sigma^2 (b^2 - a^2). White noise does the same
        whose squared density is that over the length of the interval. The same holds for a push.

        Args:
            imu: Samples in order of time, with some before the interval.
            from_us: Begin of the interval.
            to_us: Its end.
        """
        share = blind_s2(imu, from_us, to_us) * US_PER_S / max(to_us - from_us, 1)
        if share == 0.0:
            return self
        root = float(np.sqrt(share))
        return replace(
            self,
            gyro_rad_s_rthz=float(np.hypot(self.gyro_rad_s_rthz, BLIND_RAD_S * root)),
            accel_mps2_rthz=float(np.hypot(self.accel_mps2_rthz, BLIND_MPS2 * root)),
        )

    def over(self, samples: Array) -> Array:
        """The four for some segments, errors of scale and axes as noise in their place.

        A turn by a is wrong by `scale_error` a. White noise that does the same over `SPELL_S` has
        a density of scale_error |rate| sqrt(SPELL_S); the rate is that of the whole turn, for
        what goes to and fro cancels. Of the force only what differs from g counts: the rest is
        like a bias.
        """
        h, span_s = samples[:, 0], max(float(samples[:, 0].sum()), 1e-6)
        rate = float(np.linalg.norm(h @ samples[:, 1:4])) / span_s
        force = abs(float(np.linalg.norm(h @ samples[:, 4:7])) / span_s - GRAVITY_MPS2)
        densities, factor = self.densities(), self.scale_error * np.sqrt(SPELL_S)
        densities[0] = np.hypot(densities[0], factor * rate)
        densities[1] = np.hypot(densities[1], factor * force)
        return densities


NO_SAMPLES = ImuReading(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))


def join(a: ImuReading, b: ImuReading) -> ImuReading:
    """Samples of a, then those of b."""
    return ImuReading(
        np.concatenate([a.stamp_us, b.stamp_us]),
        np.concatenate([a.gyro_I, b.gyro_I]),
        np.concatenate([a.accel_I, b.accel_I]),
    )


def since(imu: ImuReading, stamp_us: TimeUs) -> ImuReading:
    """Samples from the last one at or before a time on: all that `segments` from it needs."""
    first = max(0, int(np.searchsorted(imu.stamp_us, stamp_us, side="right")) - 1)
    return ImuReading(imu.stamp_us[first:], imu.gyro_I[first:], imu.accel_I[first:])


def segments(imu: ImuReading, from_us: TimeUs, to_us: TimeUs) -> Array:
    """Mean rate and force between neighbouring samples, cut to an interval.

    Rates and forces are linear between samples and held before the first and after the last.

    Args:
        imu: Samples in order of time, at least one.
        from_us: Begin of the interval.
        to_us: Its end.

    Returns:
        Duration [s], angular rate [rad/s], specific force [m/s^2] of each segment, (k, 7).
    """
    inside = (imu.stamp_us > from_us) & (imu.stamp_us < to_us)
    knots = np.concatenate([[from_us], imu.stamp_us[inside], [to_us]])
    both = np.hstack([imu.gyro_I, imu.accel_I])
    # Times relative to the interval: a double does not hold absolute microseconds and fractions.
    at, have = knots - from_us, imu.stamp_us - from_us
    values = np.column_stack([np.interp(at, have, column) for column in both.T])
    return np.column_stack([np.diff(knots) / US_PER_S, 0.5 * (values[1:] + values[:-1])])


def advance(state: NavState, samples: Array, noise: Array) -> tuple[NavState, Array, Array]:
    """The state after some segments, the transition of its error and the noise it gathers.

    Returns:
        State, Phi (15, 15), Q (15, 15): see `propagation.propagate`.
    """
    x = np.concatenate([state.p_WI, state.v_WI, state.gyro_bias, state.accel_bias])
    R, Phi, Q = quat_to_R(state.q_WI), np.empty((NE, NE)), np.empty((NE, NE))
    propagate(x, R, GRAVITY_W, samples, noise, Phi, Q)
    moved = NavState(x[:3], R_to_quat(R), x[3:6], state.gyro_bias, state.accel_bias)
    return moved, Phi, Q
