# SPDX-License-Identifier: Apache-2.0
"""Topics that are logged at a fixed rate: poses, cables, reference, markers."""

import numpy as np

from skyhaul.evaluation import messages
from skyhaul.evaluation.mcap_log import McapLog
from skyhaul.evaluation.ros2.cdr import Stencil, codec
from skyhaul.geometry.quaternion import quat_rotate
from skyhaul.mission.api import Tick
from skyhaul.plant.api import Truth
from skyhaul.types import ERR_P, ERR_R, ERR_V, ERR_W, IntArray, TimeUs
from skyhaul.world.scenario import Scenario

POSE_PERIOD_US: TimeUs = 20_000
"""Odometry, transforms, cables, reference [us]."""
MARKER_PERIOD_US: TimeUs = 50_000
"""Markers of the team and of moving obstacles [us]."""

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
        room = scenario.world.room
        edges = messages.room_marker(room.min_m, room.max_m)
        log.write("/world/room", "visualization_msgs/MarkerArray", 0, (edges,))
        still = [
            marker
            for j, o in enumerate(self._obstacles)
            if j not in movers
            for marker in messages.obstacle_markers(0, "static", j, o.shape, np.array(o.center_m))
        ]
        log.write("/world/static", "visualization_msgs/MarkerArray", 0, still)

    def tick(self, tick: Tick) -> None:
        """Log what is due at this step."""
        t_us = tick.truth.stamp_us
        if t_us % POSE_PERIOD_US == 0:
            self._poses(t_us, tick)
        if t_us % MARKER_PERIOD_US == 0:
            self._markers(t_us, tick.truth)

    def _poses(self, t_us: TimeUs, tick: Tick) -> None:
        truth, bodies, log = tick.truth, self._bodies, self._log
        team, cables = truth.team, truth.cables
        bodies[0] = team.load
        bodies[1:, 0:3], bodies[1:, 3:7] = team.p_WB, team.q_WB
        bodies[1:, 7:10], bodies[1:, 10:13] = team.v_WB, team.w_WB_B
        at, frames = messages.stamp(t_us), list[float]()
        poses, twists = messages.poses_and_twists(bodies)
        for k, (topic, stencil) in enumerate(zip(self._topics, self._odometry, strict=True)):
            where = (*at, *poses[k])
            data = stencil.fill((*where, *twists[k]))
            log.write_encoded(topic, "nav_msgs/Odometry", t_us, data)
            frames += where
        log.write_encoded("/tf", "tf2_msgs/TFMessage", t_us, self._transforms.fill(frames))
        estimate = tick.estimate
        cov = estimate.load_covariance
        leaves = messages.odometry(
            t_us,
            "payload_estimate",
            estimate.team.load,
            np.ravel(cov[_POSE_OF_COV]),
            np.ravel(cov[_TWIST_OF_COV]),
        )
        log.write("/payload/estimate", "nav_msgs/Odometry", t_us, *leaves)
        if np.isfinite(tick.reference[0]):
            desired = messages.pose(tick.reference[0:3], tick.reference[3:7])
            at = messages.header(t_us)
            log.write("/payload/reference", "geometry_msgs/PoseStamped", t_us, *at, *desired)
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

    def _markers(self, t_us: TimeUs, truth: Truth) -> None:
        team = truth.team
        p_WA = team.p_WL + quat_rotate(team.q_WL, self._p_LA)
        markers = messages.team_markers(
            t_us, self._team, team.load, team.p_WB, team.q_WB, p_WA, truth.attached
        )
        self._log.write("/team/markers", "visualization_msgs/MarkerArray", t_us, *markers)
        moving = []
        for j in self._movers:
            if truth.present[j]:
                p = truth.obstacles.p_WO[j]
                shape = self._obstacles[j].shape
                moving += messages.obstacle_markers(t_us, "mover", int(j), shape, p)
        if moving:
            self._log.write("/world/movers", "visualization_msgs/MarkerArray", t_us, moving)


def _stencils(names: list[str]) -> tuple[list[Stencil], Stencil]:
    """Of the odometry of each body, and of the transforms of all."""
    rest = np.zeros(13)
    rest[3] = 1.0
    leaves = [messages.odometry(0, name, rest, _EXACT, _EXACT) for name in names]
    odometry = [codec("nav_msgs/Odometry").stencil(*one) for one in leaves]
    return odometry, codec("tf2_msgs/TFMessage").stencil([one[:11] for one in leaves])
