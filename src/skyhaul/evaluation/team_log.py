# SPDX-License-Identifier: Apache-2.0
"""Topics that are logged at a fixed rate: poses, cables, reference, markers."""

import math

import numpy as np

from skyhaul.evaluation import messages
from skyhaul.evaluation.mcap_log import McapLog
from skyhaul.evaluation.ros2.cdr import Stencil, codec
from skyhaul.geometry.kernels import quat_to_R
from skyhaul.mission.api import Tick
from skyhaul.model.state import TeamState
from skyhaul.model.team import Team
from skyhaul.plant.api import Truth
from skyhaul.types import ERR_P, ERR_R, ERR_V, ERR_W, US_PER_S, Array, IntArray, Mask, TimeUs
from skyhaul.world.scenario import Scenario

POSE_PERIOD_US: TimeUs = 20_000
"""Odometry, transforms, cables, reference [us]."""
MARKER_PERIOD_US: TimeUs = 50_000
"""Markers of the team and of moving obstacles [us]."""

_ODOMETRY, _POSE = "nav_msgs/Odometry", "geometry_msgs/PoseStamped"
_MARKERS = "visualization_msgs/MarkerArray"
_TWO = ((0, 0.0), (US_PER_S + 1, 1.0))
"""Times [us] and values that differ in every number."""
_EXACT = np.zeros(36)
_POSE_OF_COV = np.ix_(np.r_[ERR_P, ERR_R], np.r_[ERR_P, ERR_R])
_TWIST_OF_COV = np.ix_(np.r_[ERR_V, ERR_W], np.r_[ERR_V, ERR_W])
"""Where ROS's two covariances stand in the load's."""


class TeamLog:
    """Writes the regular topics."""

    def __init__(self, log: McapLog, scenario: Scenario, movers: IntArray) -> None:
        self._log = log
        self._team = scenario.team
        self._p_LA = scenario.team.hooks_L()
        self._obstacles = scenario.world.obstacles
        self._movers = movers
        n = scenario.team.count
        self._names = ["payload", *(f"vehicle_{i}" for i in range(n))]
        self._topics = [f"/{name}/odometry" for name in self._names]
        self._bodies = np.empty((1 + n, 13))
        self._odometry, self._transforms = _stencils(self._names)
        self._estimate, self._covariance = self._odometry[0], np.empty((0, 0))
        pose = messages.pose(np.zeros(3), np.zeros(4))
        self._reference = codec(_POSE).stencil(*messages.header(0), *pose)
        self._of_team: dict[bytes, Stencil] = {}
        self._of_movers: dict[tuple[int, ...], tuple[Stencil, IntArray, Array]] = {}
        room = scenario.world.room
        edges = messages.room_marker(room.min_m, room.max_m)
        log.write("/world/room", _MARKERS, 0, (edges,))
        still = [
            marker
            for j, o in enumerate(self._obstacles)
            if j not in movers
            for marker in messages.obstacle_markers(0, "static", j, o.shape, np.array(o.center_m))
        ]
        log.write("/world/static", _MARKERS, 0, still)

    def tick(self, tick: Tick) -> None:
        """Log what is due at this step."""
        t_us = tick.truth.stamp_us
        if t_us % POSE_PERIOD_US == 0:
            self._poses(t_us, tick)
        if t_us % MARKER_PERIOD_US == 0:
            self._markers(t_us, tick.truth)

    def _rows(self, team: TeamState) -> tuple[list[list[float]], list[list[float]]]:
        """Poses and twists of all bodies, as ROS orders them."""
        bodies = self._bodies
        bodies[0] = team.load
        bodies[1:, 0:3], bodies[1:, 3:7] = team.p_WB, team.q_WB
        bodies[1:, 7:10], bodies[1:, 10:13] = team.v_WB, team.w_WB_B
        return messages.poses_and_twists(bodies)

    def _poses(self, t_us: TimeUs, tick: Tick) -> None:
        truth, estimate, log = tick.truth, tick.estimate, self._log
        at, frames, cables = messages.stamp(t_us), list[float](), truth.cables
        poses, twists = self._rows(truth.team)
        for k, (topic, stencil) in enumerate(zip(self._topics, self._odometry, strict=True)):
            where = (*at, *poses[k])
            log.write_encoded(topic, _ODOMETRY, t_us, stencil.fill((*where, *twists[k])))
            frames += where
        log.write_encoded("/tf", "tf2_msgs/TFMessage", t_us, self._transforms.fill(frames))
        motion = (*poses[0], *twists[0])
        if estimate.team is not truth.team:
            load = estimate.team.load
            motion = (*messages.pose(load[0:3], load[3:7]), *messages.twist(load))
        data = self._of_estimate(estimate.load_covariance).fill((*at, *motion))
        log.write_encoded("/payload/estimate", _ODOMETRY, t_us, data)
        x = tick.reference
        if math.isfinite(x[0]):
            data = self._reference.fill((*at, *messages.pose(x[0:3], x[3:7])))
            log.write_encoded("/payload/reference", _POSE, t_us, data)
        log.write(
            "/cables",
            "skyhaul_msgs/CableStates",
            t_us,
            *messages.header(t_us),
            cables.dir_W.tolist(),
            cables.length,
            cables.tension,
            truth.attached,
        )

    def _of_estimate(self, cov: Array) -> Stencil:
        """The estimate's odometry with this covariance, which may stay the same."""
        if cov is not self._covariance:
            two = (np.ravel(cov[_POSE_OF_COV]), np.ravel(cov[_TWIST_OF_COV]))
            leaves = messages.odometry(0, "payload_estimate", _at_rest(), *two)
            self._covariance, self._estimate = cov, codec(_ODOMETRY).stencil(*leaves)
        return self._estimate

    def _markers(self, t_us: TimeUs, truth: Truth) -> None:
        """Names, sizes and colours stay; times and places change."""
        at, team, attached = messages.stamp(t_us), truth.team, truth.attached
        stencil = self._of_team.get(attached.tobytes())
        if stencil is None:
            stencil = self._of_team[attached.tobytes()] = _team_stencil(self._team, attached)
        numbers = list[float]()
        for pose in self._rows(team)[0]:
            numbers += (*at, *pose)
        R_WL = np.empty((3, 3))
        quat_to_R(team.q_WL, R_WL)
        p_WA = team.p_WL + self._p_LA @ R_WL.T
        numbers += (*at, *np.stack([p_WA, team.p_WB], axis=1)[attached].ravel().tolist())
        self._log.write_encoded("/team/markers", _MARKERS, t_us, stencil.fill(numbers))
        self._mover_markers(t_us, truth)

    def _mover_markers(self, t_us: TimeUs, truth: Truth) -> None:
        there = tuple(j for j in self._movers.tolist() if truth.present[j])
        if not there:
            return
        known = self._of_movers.get(there)
        if known is None:
            known = self._of_movers[there] = self._mover_stencil(there)
        stencil, rows, offsets = known
        at, numbers = messages.stamp(t_us), list[float]()
        for place in (truth.obstacles.p_WO[rows] + offsets).tolist():
            numbers += (*at, *place)
        self._log.write_encoded("/world/movers", _MARKERS, t_us, stencil.fill(numbers))

    def _mover_stencil(self, there: tuple[int, ...]) -> tuple[Stencil, IntArray, Array]:
        """Markers of these obstacles, in which times and places change.

        Returns:
            The stencil; of each marker the obstacle, and its place from there [m].
        """
        one, other = (
            [
                marker
                for j in there
                for marker in messages.obstacle_markers(
                    t_us, "mover", j, self._obstacles[j].shape, np.full(3, place)
                )
            ]
            for t_us, place in _TWO
        )
        shapes = [self._obstacles[j].shape for j in there]
        offsets = [messages.marker_places(shape, np.zeros(3)) for shape in shapes]
        rows = np.repeat(there, [len(places) for places in offsets])
        return codec(_MARKERS).stencil(one, other=(other,)), rows, np.concatenate(offsets)


def _team_stencil(team: Team, attached: Mask) -> Stencil:
    """Markers of the team, in which times, poses and the ends of the cables change."""
    n = team.count
    one, other = (
        messages.team_markers(
            t_us,
            team,
            np.full(13, x),
            np.full((n, 3), x),
            np.full((n, 4), x),
            np.full((n, 3), x),
            attached,
        )
        for t_us, x in _TWO
    )
    return codec(_MARKERS).stencil(*one, other=other)


def _at_rest() -> Array:
    rest = np.zeros(13)
    rest[3] = 1.0
    return rest


def _stencils(names: list[str]) -> tuple[list[Stencil], Stencil]:
    """Of the odometry of each body, and of the transforms of all."""
    leaves = [messages.odometry(0, name, _at_rest(), _EXACT, _EXACT) for name in names]
    odometry = [codec(_ODOMETRY).stencil(*one) for one in leaves]
    return odometry, codec("tf2_msgs/TFMessage").stencil([one[:11] for one in leaves])
