# SPDX-License-Identifier: Apache-2.0
"""The team's state from odometry, tag, IMUs and rotor thrust: one filter for load and frames."""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.model.state import CableState, TeamState
from skyhaul.model.team import Team
from skyhaul.params import Params
from skyhaul.perception.api import TeamEstimate
from skyhaul.perception.team import layout
from skyhaul.perception.team.api import FrameOffset, SurveyedTeam, TeamReports
from skyhaul.perception.team.filter import Arrived, tick
from skyhaul.perception.team.layout import KEPT, NAV_NX, VEHICLE_NE, FilterParams, FilterState
from skyhaul.perception.team.motion import vehicle_at
from skyhaul.perception.team.output import Output
from skyhaul.perception.team.sights import place_load
from skyhaul.perception.team.tag import tag_corners_L, tag_pose
from skyhaul.perception.vio.api import VioEstimate
from skyhaul.sensors.api import (
    CameraCalibration,
    ImuCalibration,
    TagCalibration,
    VehicleCalibration,
)
from skyhaul.types import LOAD_P, LOAD_Q, LOAD_V, LOAD_W, US_PER_S, Array, Mask


class FusedMemory(NamedTuple):
    """What the filter remembers."""

    state: FilterState


@dataclass(frozen=True, kw_only=True)
class FusedTeam(Params):
    """Error-state filter over the load and the drift of every vehicle's frame."""

    kind: Literal["fused"] = "fused"
    sigma_px: float = 0.5
    """Error of a corner of the tag [px]."""
    tag_scale: float = 0.9935
    """Size of the tag as the detector finds it, of its true size; from flights of `hover` and
    `lost-vehicle`, where edges of 38 px are found 0.12 px further in on each side [-]."""
    sigma_length_m: float = 0.004
    """Error of a taut cable's length [m]."""
    sigma_direction_rad: float = 0.015
    """Error of a cable's direction from specific force, over 50 ms [rad]."""
    sigma_force_n: float = 0.03
    """Error of a sum of cable forces over 50 ms [N]."""
    sigma_moment_nm: float = 0.004
    """Error of the moment of the cable forces over 50 ms [N m]."""
    force_bias_n: float = 0.05
    """Standard deviation of what is added to a vehicle's cable force by thrust and IMU [N]."""
    force_walk_n_per_sqrt_s: float = 0.004
    """Its random walk [N/sqrt(s)]."""
    tilt_time_s: float = 5.0
    """Roll and pitch errors of odometry are correlated this long [s]."""
    frame_walk_m_per_sqrt_s: float = 0.006
    """Least random walk of a vehicle's frame: odometry's error changes by 2 mm and more from one
    rig frame to the next, of which its covariance, which may even shrink, tells nothing
    [m/sqrt(s)]."""
    frame_walk_deg_per_sqrt_s: float = 0.02
    """Least random walk of its heading [deg/sqrt(s)]."""
    imu_noise_factor: float = 1.4
    """On the densities of the load's IMU, for scale errors, misalignment and digits [-]."""
    gyro_bias_radps: float = 0.003
    """Standard deviation of the load's gyro bias at the start [rad/s]."""
    accel_bias_mps2: float = 0.07
    """Standard deviation of the load's accelerometer bias at the start [m/s^2]."""
    taut_n: float = 0.05
    """A cable that pulls more is taut [N]."""
    slack_n: float = 0.025
    """A cable that pulls less is slack [N]."""
    slack_m: float = 0.03
    """A cable whose hook is nearer than its length by this is slack, but for a strong pull [m]."""
    lost_after: int = 12
    """The load is placed anew by the tag when so many sights in a row were refused."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "kind" and not value > 0.0:
                raise ValueError(f"{name} must be > 0, got {value}")
        if not self.slack_n < self.taut_n:
            raise ValueError(f"slack_n must be below taut_n = {self.taut_n}, got {self.slack_n}")

    def build(
        self,
        team: Team,
        vehicle: VehicleCalibration,
        load_imu: ImuCalibration,
        tag: TagCalibration,
        start: SurveyedTeam,
    ) -> "FusedEstimator":
        """The estimator of a team.

        Args:
            team: Masses, lengths, hooks.
            vehicle: Calibration of every vehicle's sensors; the camera named `down` sees the tag.
            load_imu: Calibration of the load's IMU.
            tag: The tag on the load.
            start: Where load and vehicles stand before the flight.
        """
        down = next(c for c in vehicle.rig.cameras if c.name == "down")
        params = _filter_params(self, team, vehicle.imu, down, load_imu, tag)
        clock_us = (_to_end_us(vehicle.imu), _to_end_us(load_imu))
        return FusedEstimator(self, params, down, load_imu, start, clock_us)


def _to_end_us(imu: ImuCalibration) -> float:
    return 0.5 * US_PER_S / imu.rate_hz - imu.clock_offset_us


def _filter_params(
    params: FusedTeam,
    team: Team,
    imu: ImuCalibration,
    down: CameraCalibration,
    load_imu: ImuCalibration,
    tag: TagCalibration,
) -> FilterParams:
    arrays = team.arrays()
    factor = params.imu_noise_factor
    return FilterParams(
        mass=arrays.m_B,
        length=arrays.length,
        hook_L=arrays.p_LA,
        load_mass=arrays.m_L,
        load_J=arrays.J_L,
        drag=(team.vehicle.drag_ns_per_m, team.payload.drag_ns_per_m),
        g=arrays.g,
        p_BI=imu.p_BI.copy(),
        R_BI=imu.R_BI.copy(),
        q_BI=R_to_quat(imu.R_BI),
        p_LI=load_imu.p_BI.copy(),
        dt=(1.0 / imu.rate_hz, 1.0 / load_imu.rate_hz),
        load_noise=np.array(
            [factor * load_imu.gyro_noise, factor * load_imu.accel_noise,
             factor * load_imu.gyro_walk, factor * load_imu.accel_walk]
        ),
        camera=down.model.arrays(),
        p_IC=imu.R_BI.T @ (down.p_BC - imu.p_BI),
        R_IC=np.ascontiguousarray(imu.R_BI.T @ down.R_BC),
        corners_L=tag_corners_L(tag, params.tag_scale) - load_imu.p_BI,
        sigma_px=params.sigma_px,
        sigma_length=params.sigma_length_m,
        sigma_direction=params.sigma_direction_rad,
        sigma_force=params.sigma_force_n,
        sigma_moment=params.sigma_moment_nm,
        force_walk=params.force_walk_n_per_sqrt_s,
        tilt_time=params.tilt_time_s,
        frame_walk=(
            params.frame_walk_m_per_sqrt_s,
            math.radians(params.frame_walk_deg_per_sqrt_s),
        ),
        taut_force=params.taut_n,
        slack_force=params.slack_n,
        slack_length=params.slack_m,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class FusedEstimator:
    """See `perception.api.TeamEstimator`, on `TeamReports`.

    500 ticks a second: IMUs move load and vehicles on, each sight of the tag, each estimate of
    odometry and, every 50 ms, each cable and the load's balance of forces correct them.
    """

    params: FusedTeam
    kernel: FilterParams
    down: CameraCalibration
    load_imu: ImuCalibration
    start: SurveyedTeam
    clock_us: tuple[float, float]
    """From a sample's stamp to the end of its period, of a vehicle's and of the load's IMU."""

    def init(self) -> FusedMemory:
        """Everything where it was surveyed, at rest."""
        p, k, start, n = self.params, self.kernel, self.start, len(self.kernel.mass)
        load, nav = np.zeros(NAV_NX), np.zeros((n, NAV_NX))
        load[:3] = start.p_WL + quat_to_R(start.q_WL) @ k.p_LI
        load[3:7] = start.q_WL
        for i in range(n):
            R = quat_to_R(start.q_WB[i])
            nav[i, :3], nav[i, 3:7] = start.p_WB[i] + R @ k.p_BI, R_to_quat(R @ k.R_BI)
        sigma = np.zeros(layout.LOAD_NE + VEHICLE_NE * n)
        six = np.repeat(
            [start.sigma_m, start.sigma_rad, 0.02, p.gyro_bias_radps, p.accel_bias_mps2], 3
        )
        sigma[: layout.LOAD_NE] = six
        for i in range(n):
            b = layout.LOAD_NE + VEHICLE_NE * i
            sigma[b : b + 6] = np.repeat([start.sigma_vehicle_m, start.sigma_vehicle_rad], 3)
            sigma[b + 6 : b + 9] = p.force_bias_n
        vio, taut = np.zeros((n, 4)), np.zeros((n, 3))
        vio[:, 3], taut[:, 2] = -1.0, -1e9
        state = FilterState(
            load=load,
            load_last=np.zeros(9),
            load_us=np.array([0.0, -1e9, 0.0, 0.0]),
            nav=nav,
            nav_last=np.zeros((n, 12)),
            vio=vio,
            vio_cov=np.zeros((n, 6, 6)),
            offset=np.zeros((n, VEHICLE_NE)),
            P=np.diag(sigma**2),
            past=np.zeros((n, KEPT, 7)),
            head=np.zeros(n),
            made_up=np.zeros(n),
            waiting=np.tile([-1.0, *np.zeros(6)], (n + 1, 1)),
            window=np.zeros((n, 8)),
            balance=np.zeros((n, 4)),
            sums=np.zeros(7),
            taut=taut,
            tally=np.zeros(4),
        )
        state.load_last[3:6] = quat_to_R(start.q_WL).T @ (0.0, 0.0, k.g)
        return FusedMemory(state)

    def step(self, memory: FusedMemory, reading: TeamReports) -> tuple[FusedMemory, TeamEstimate]:
        """Take one tick's reports in."""
        s, t_us = memory.state, reading.stamp_us
        thrust, attached = s.nav_last[:, 11].copy(), s.nav_last[:, 10] > 0.0
        samples, odometry, sights = [], [], []
        offset_us = self.clock_us[0]
        for i, report in enumerate(reading.vehicles):
            if report is None:
                continue
            thrust[i], attached[i] = report.thrust, report.attached
            imu = report.imu
            for k in range(len(imu.stamp_us)):
                samples.append((i, imu.stamp_us[k] + offset_us, *imu.gyro_I[k], *imu.accel_I[k]))
            if report.vio is not None and report.vio.state is not None:
                odometry.append(_odometry_row(i, report.vio))
            if report.tag is not None:
                sights.append((i, report.tag.stamp_us, *report.tag.corners_px.ravel()))
        arrived = Arrived(
            _table(samples, 8),
            self._load_rows(reading),
            _table(odometry, 54),
            _table(sights, 10),
        )
        s, out = tick(self.kernel, s, float(t_us), arrived, thrust, attached)
        if s.tally[2] >= self.params.lost_after:
            self._place(s, reading)
        return FusedMemory(s), _estimate(t_us, out, attached, thrust)

    def offsets(self, memory: FusedMemory) -> tuple[FrameOffset, ...]:
        """What turns each vehicle's odometry into the team's frame."""
        s, out = memory.state, []
        for i in range(len(self.kernel.mass)):
            b, o = layout.LOAD_NE + VEHICLE_NE * i, s.offset[i]
            part = s.P[b : b + 6, b : b + 6].copy()
            out.append(FrameOffset(o[:3].copy(), o[3:6].copy(), part))
        return tuple(out)

    def _load_rows(self, reading: TeamReports) -> Array:
        """Samples of the load's IMU in L axes: time at the end of the period, rate, force."""
        imu, offset_us, R = reading.load_imu, self.clock_us[1], self.load_imu.R_BI
        rows = [
            (imu.stamp_us[k] + offset_us, *(R @ imu.gyro_I[k]), *(R @ imu.accel_I[k]))
            for k in range(len(imu.stamp_us))
        ]
        return _table(rows, 7)

    def _place(self, s: FilterState, reading: TeamReports) -> None:
        """Place the load where the tag is now, by the first that sees and holds it; in place."""
        for i, report in enumerate(reading.vehicles):
            if report is not None and report.tag is not None and report.attached:
                pose = tag_pose(report.tag, self.down, self.kernel.corners_L)
                if pose is None:
                    continue
                p_CI, R_CI = pose
                y = vehicle_at(self.kernel, s, i, float(report.tag.stamp_us))
                R_WC = quat_to_R(y[3:7]) @ self.kernel.R_IC
                where = s.load.copy()
                where[:3] = y[:3] + quat_to_R(y[3:7]) @ self.kernel.p_IC + R_WC @ p_CI
                where[3:7] = R_to_quat(R_WC @ R_CI)
                place_load(s, where, 0.05, 0.05)
                return


_EMPTY = {width: np.zeros((0, width)) for width in (7, 8, 10, 54)}


def _table(rows: list[Any], width: int) -> Array:
    return np.array(rows, dtype=np.float64) if rows else _EMPTY[width]


def _odometry_row(i: int, estimate: VioEstimate) -> Array:
    """Vehicle, time, pose and motion, covariance of p and turn in W axes, (54,)."""
    x, R = estimate.state, np.eye(6)
    assert x is not None, "asked for before"
    R[3:, 3:] = quat_to_R(x.q_WI)
    cov = R @ estimate.covariance[:6, :6] @ R.T
    nav = (x.p_WI, x.q_WI, x.v_WI, x.gyro_bias, x.accel_bias)
    return np.concatenate([[i, estimate.stamp_us], *nav, cov.ravel()])


def _estimate(t_us: int, out: Output, attached: Mask, thrust: Array) -> TeamEstimate:
    x = out.load
    team = TeamState(
        x[LOAD_P], x[LOAD_Q], x[LOAD_V], x[LOAD_W], out.p_WB, out.q_WB, out.v_WB, out.w_WB_B
    )
    cables = CableState(out.dir_W, out.w_W, out.tension, out.length)
    return TeamEstimate(t_us, team, cables, attached, thrust, out.covariance)
