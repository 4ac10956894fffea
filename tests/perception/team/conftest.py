# SPDX-License-Identifier: Apache-2.0
"""Made-up flights of a team with exact truth: motion from flatness, IMUs, tag and odometry."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from skyhaul.geometry.camera import project_points
from skyhaul.geometry.quaternion import (
    R_to_quat,
    quat_conj,
    quat_exp,
    quat_log,
    quat_mul,
    quat_rotate,
    quat_to_R,
)
from skyhaul.geometry.so3 import so3_exp
from skyhaul.model import RigidPayload, Team
from skyhaul.model.flatness import flat_outputs
from skyhaul.model.team import Vehicle
from skyhaul.perception.team.api import SurveyedTeam, TagSight, TeamReports, VehicleReport
from skyhaul.perception.team.fused import FusedTeam
from skyhaul.perception.team.tag import tag_corners_L
from skyhaul.perception.vio.api import NavState, VioEstimate, VioStatus
from skyhaul.sensors.api import ImuReading
from skyhaul.sensors.config import SensorsConfig
from skyhaul.sensors.imu import imu_bank, without_errors
from skyhaul.sensors.imu_kernel import Motion

NO_IMU = ImuReading(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
ORDER = 6


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what the sensors and the odometry add."""

    imu: bool = True
    tag_px: float = 0.5
    drift_m_per_sqrt_s: float = 0.03
    drift_rad_per_sqrt_s: float = 0.003
    tilt_rad: float = 0.003
    velocity_mps: float = 0.01
    thrust_scale: float = 0.008


EXACT = Noise(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(eq=False)
class Synthetic:
    """Truth at every tick and what the estimator gets of it."""

    team: Team
    sensors: SensorsConfig
    p_WL: np.ndarray
    q_WL: np.ndarray
    v_WL: np.ndarray
    w_WL_L: np.ndarray
    p_WB: np.ndarray
    dir_W: np.ndarray
    w_W: np.ndarray
    tension: np.ndarray
    reports: list
    start: SurveyedTeam

    def estimator(self, params=None):
        return (params or FusedTeam(tag_scale=1.0)).build(
            self.team,
            self.sensors.calibration(),
            self.sensors.payload_imu.calibration(),
            self.sensors.tag(self.team),
            self.start,
        )

    def error(self, k, estimate):
        """Of the load, layout of `types.ERR_P`."""
        t = estimate.team
        turn = quat_log(quat_mul(quat_conj(t.q_WL), self.q_WL[k]))
        return np.concatenate(
            [self.p_WL[k] - t.p_WL, turn, self.v_WL[k] - t.v_WL, self.w_WL_L[k] - t.w_WL_L]
        )


def _from_rest(rate, t):
    """Derivatives 0..6 of 1 - cos(rate t)."""
    k = np.arange(ORDER + 1)
    return rate**k * np.sin(rate * t - np.pi / 2 + k * np.pi / 2) + (k == 0)


def _swing(axis, s):
    """Derivatives 0..6 of Exp(axis s) from those of s."""
    S = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = [so3_exp(axis * s[0])]
    for k in range(ORDER):
        R.append(sum(math.comb(k, j) * R[j] @ S * s[k - j + 1] for j in range(k + 1)))
    return np.array(R)


def make(seed=0, seconds=4.0, noise=None, hidden_s=(9e9, 9e9), silent_s=(9e9, 9e9), size=1.0):
    """A flight of four vehicles on sines; the same arguments, the same bytes."""
    noise, rng = noise or Noise(), np.random.default_rng([seed, 5])
    team = Team(vehicle=Vehicle(drag_ns_per_m=0.0), payload=RigidPayload(drag_ns_per_m=0.0))
    sensors = SensorsConfig()
    if not noise.imu:
        sensors = replace(
            sensors,
            imu=without_errors(sensors.imu),
            payload_imu=without_errors(sensors.payload_imu),
        )
    n, times = team.count, 0.002 * np.arange(round(seconds / 0.002) + 1)
    way, rates = size * np.array([0.8, 0.6, 0.3]), rng.uniform(0.8, 1.4, 3)
    axis = size * np.array([0.06, -0.05, 0.15])
    p = np.array(
        [
            np.column_stack([w * _from_rest(r, t) for w, r in zip(way, rates, strict=True)])
            for t in times
        ]
    )
    R = np.array([_swing(axis, _from_rest(1.1, t)) for t in times])
    yaw = np.zeros((n, 3))
    yaw[:, 0] = team.azimuths_rad  # they look away from the load
    flat = flat_outputs(team, p, R, yaw)
    q_WL, p_WB = R_to_quat(R[:, 0]), flat.p_WB[:, 0]
    v_WB, q_WB, w_WB = flat.p_WB[:, 1], flat.q_WB, flat.w_WB_B
    motions = [
        Motion(q_WL[k], p[k, 1].copy(), flat.w_WL_L[k], q_WB[k], v_WB[k].copy(), w_WB[k])
        for k in range(len(times))
    ]
    scale = 1.0 + noise.thrust_scale * rng.standard_normal(n)
    thrust = flat.wrench[:, :, 0] * scale
    bank = imu_bank([sensors.payload_imu, *[sensors.imu] * n], range(n + 1))
    memory, biases, imus = bank.init(seed), None, []
    for k, motion in enumerate(motions):
        memory, readings = bank.step(memory, 2_000 * k, motion)
        imus.append(readings)
    biases = memory.bias
    made = _reports(
        team, sensors, noise, rng, (times, p, q_WL, p_WB, q_WB, v_WB, w_WB), imus, thrust, biases,
        (hidden_s, silent_s),
    )  # fmt: skip
    start = SurveyedTeam(
        p[0, 0] + 0.01 * noise.imu * rng.standard_normal(3),
        quat_mul(q_WL[0], quat_exp(0.02 * noise.imu * rng.standard_normal(3))),
        p_WB[0].copy(),
        q_WB[0].copy(),
    )
    return Synthetic(
        team, sensors, p[:, 0], q_WL, p[:, 1], flat.w_WL_L, p_WB, flat.cable_dir_W[:, 0],
        flat.cable_w_W, np.linalg.norm(flat.force_W[:, 0], axis=2), made, start,
    )  # fmt: skip


def _reports(team, sensors, noise, rng, truth, imus, thrust, biases, gaps):
    times, p, q_WL, p_WB, q_WB = truth[:5]
    n, tag = team.count, sensors.tag(team)
    down = next(c for c in sensors.calibration().rig.cameras if c.name == "down")
    corners, arm = tag_corners_L(tag), sensors.imu.calibration().p_BI
    drift = np.zeros((n, 4))
    tilt = noise.tilt_rad * rng.standard_normal((n, 2))
    before = [None] * n
    out = []
    for k, t in enumerate(times):
        reports = []
        for i in range(n):
            vio = sight = None
            if k % 50 == 12 * i:
                state = _drifted(noise, rng, drift, tilt, before, (k, i), truth, arm)
                vio = _estimate(2_000 * k, noise, state, before[i], biases[1 + i], rng)
            if k % 50 == 12 * i and not gaps[0][0] <= t < gaps[0][1]:
                R_WB = quat_to_R(q_WB[k, i])
                at = p[k, 0] + quat_rotate(q_WL[k], corners) - p_WB[k, i]
                px, ok = project_points(down.model, ((at @ R_WB) - down.p_BC) @ down.R_BC)
                px = px + noise.tag_px * rng.standard_normal((4, 2))
                sight = TagSight(2_000 * k, 3, px) if ok.all() else None
            reports.append(VehicleReport(imus[k][1 + i], vio, sight, float(thrust[k, i]), True))
        silent = gaps[1][0] <= t < gaps[1][1]
        out.append(TeamReports(2_000 * k, tuple(reports), NO_IMU if silent else imus[k][0]))
    return out


def _drifted(noise, rng, drift, tilt, before, at, truth, arm):
    """Advance the drift of vehicle i: a random walk, and the way turned by the yaw's error."""
    (k, i), (_, _, _, p_WB, q_WB, v_WB, w_WB) = at, truth
    first = before[i] is None
    dt = 0.1 * (not first)
    here = p_WB[k, i] + quat_rotate(q_WB[k, i], arm)
    way = np.zeros(3) if first else here - before[i][0]
    C = np.diag([1e-6] * 4) if first else before[i][1]
    F = np.eye(4)
    F[0, 3], F[1, 3] = -way[1], way[0]
    Q = np.diag([noise.drift_m_per_sqrt_s**2 * dt] * 3 + [noise.drift_rad_per_sqrt_s**2 * dt])
    C = F @ C @ F.T + Q
    drift[i] = F @ drift[i] + np.sqrt(np.diag(Q)) * rng.standard_normal(4)
    if first:
        drift[i] = 1e-3 * (noise.drift_m_per_sqrt_s > 0) * rng.standard_normal(4)
    keep = math.exp(-dt / 5.0)
    tilt[i] = keep * tilt[i] + noise.tilt_rad * math.sqrt(1 - keep**2) * rng.standard_normal(2)
    before[i] = (here, C)
    turn = np.array([*tilt[i], drift[i, 3]])
    swing = quat_rotate(q_WB[k, i], np.cross(w_WB[k, i], arm))
    v = v_WB[k, i] + swing + noise.velocity_mps * rng.standard_normal(3)
    return here + drift[i, :3], quat_mul(quat_exp(turn), q_WB[k, i]), v


def _estimate(stamp_us, noise, pose, before, bias, rng):
    """Odometry with the covariance that follows from its errors."""
    W = np.zeros((6, 6))
    W[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])] = before[1]
    W[3, 3] = W[4, 4] = noise.tilt_rad**2 + 1e-10
    R = np.eye(6)
    R[3:, 3:] = quat_to_R(pose[1])
    cov = np.diag(np.repeat([0.0, 0.0, noise.velocity_mps**2 + 1e-8, 1e-8, 1e-6], 3))
    cov[:6, :6] = R.T @ W @ R
    state = NavState(pose[0], pose[1], pose[2], bias[:3].copy(), bias[3:].copy())
    return VioEstimate(stamp_us, VioStatus.TRACKING, state, cov, 40, 0)


@pytest.fixture(scope="session")
def flight():
    """A made-up flight."""
    return make


@pytest.fixture(scope="session")
def exact():
    """Sensors and odometry without error."""
    return EXACT
