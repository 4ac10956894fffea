# SPDX-License-Identifier: Apache-2.0
"""Topics that are logged when something happens: plans, solves, triggers, contacts, the map."""

from collections import Counter

import numpy as np

from skyhaul.comms.api import Envelope
from skyhaul.evaluation import messages
from skyhaul.evaluation.mcap_log import McapLog
from skyhaul.mapping.api import WorldMap
from skyhaul.mission.api import Outcome, Phase, Replan, Solve, Trigger
from skyhaul.planning.api import Reference
from skyhaul.plant.api import Contact, Truth
from skyhaul.types import US_PER_S, Mask, TimeUs

PATH_PERIOD_US: TimeUs = 100_000
"""Sampling of references in the log [us]; a long one gets `PATH_POINTS` samples instead."""
PATH_POINTS = 400
TRACKS_PERIOD_US: TimeUs = 100_000
VOXELS_PERIOD_US: TimeUs = 500_000
STATISTICS_PERIOD_US: TimeUs = 1_000_000
"""Tracks, voxels and statistics are not logged more often than this [us]."""


class EventsLog:
    """Writes the irregular topics and counts the messages on the bus."""

    def __init__(self, log: McapLog) -> None:
        self._log = log
        self._counts: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()
        self._statistics_us: TimeUs = 0
        self._tracks_us: TimeUs = -TRACKS_PERIOD_US
        self._voxels_us: TimeUs = -VOXELS_PERIOD_US
        self._version = -1
        self._voxels: Mask = np.zeros((0, 0, 0), dtype=np.bool_)
        self._p_WO = np.zeros(3)
        self.closed = False

    def phase(self, t_us: TimeUs, phase: Phase, airborne: bool) -> None:
        """A phase begins."""
        at = messages.header(t_us)
        self._log.write("/mission/phase", "skyhaul_msgs/Phase", t_us, *at, phase.value, airborne)

    def contact(self, contact: Contact, airborne: bool, truth: Truth) -> None:
        """Two bodies begin to touch."""
        t_us = contact.stamp_us
        a, b = contact.body_a, contact.body_b
        lost = (_is_lost(a, truth) and b == "room") or (_is_lost(b, truth) and a == "room")
        self._log.write(
            "/contact",
            "skyhaul_msgs/Contact",
            t_us,
            *messages.header(t_us),
            contact.body_a,
            contact.body_b,
            airborne,
            airborne and lost,
        )

    def trigger(self, trigger: Trigger) -> None:
        """Something fired."""
        t_us, at = trigger.stamp_us, messages.header(trigger.stamp_us)
        cause, detail = trigger.cause, trigger.detail
        self._log.write("/trigger", "skyhaul_msgs/Trigger", t_us, *at, cause, detail)

    def replan(self, replan: Replan) -> None:
        """A reference was planned, accepted or not."""
        result, t_us = replan.result, replan.stamp_us
        self._log.write(
            "/plan/replan",
            "skyhaul_msgs/Replan",
            t_us,
            *messages.header(t_us),
            replan.cause,
            result.status.value,
            result.path.status.value,
            replan.accepted,
            result.reaches_goal,
            result.waits_us / US_PER_S,
            result.path.n_expanded,
            result.path.p_WP.tolist(),
            replan.wall_ms,
        )

    def reference(self, stamp_us: TimeUs, reference: Reference) -> None:
        """A reference came into force: its curve from now to its end, with times."""
        start = max(stamp_us, reference.start_us)
        span = max(0, reference.end_us - start)
        count = min(PATH_POINTS, 2 + span // PATH_PERIOD_US)
        t_us = np.linspace(start, start + span, count)
        p_WD = reference.sample(t_us).p_WD[:, 0, :]
        poses = [
            (*messages.header(round(t)), *p, *messages.IDENTITY)
            for t, p in zip(t_us.tolist(), p_WD.tolist(), strict=True)
        ]
        at = messages.header(stamp_us)
        self._log.write("/plan/reference", "nav_msgs/Path", stamp_us, *at, poses)

    def solve(self, solve: Solve) -> None:
        """A control plan was solved."""
        t_us, s = solve.stamp_us, solve.solution
        self._log.write(
            "/control/solve",
            "skyhaul_msgs/Solve",
            t_us,
            *messages.header(t_us),
            solve.cause,
            s.status.value,
            s.kkt_residual,
            s.iterations,
            s.slack_m,
            s.wall_ms,
        )
        plan = s.plan
        self._log.write(
            "/control/plan",
            "skyhaul_msgs/ForcePlan",
            t_us,
            *messages.header(plan.stamp_us),
            len(plan.node_s),
            len(plan.active),
            plan.node_s,
            plan.load,
            plan.accel_W,
            plan.force_W,
            plan.dforce_W,
            plan.gain,
            plan.thrust,
            plan.active,
        )

    def map(self, world_map: WorldMap) -> None:
        """M(t) changed: its tracks, and the voxels that differ."""
        t_us = world_map.stamp_us
        if t_us >= self._tracks_us + TRACKS_PERIOD_US:
            self._tracks_us = t_us
            tracks = [messages.track(item) for item in world_map.tracks]
            at = messages.header(t_us)
            self._log.write("/map/tracks", "skyhaul_msgs/Tracks", t_us, *at, tracks)
        due = t_us >= self._voxels_us + VOXELS_PERIOD_US
        if world_map.version != self._version and due:
            self._voxels_us, self._version = t_us, world_map.version
            self._voxel_delta(t_us, world_map)

    def message(self, envelope: Envelope[object]) -> None:
        """A message went over the bus."""
        self._counts[envelope.topic] += 1
        self._bytes[envelope.topic] += envelope.size_bytes
        if envelope.sent_us >= self._statistics_us + STATISTICS_PERIOD_US:
            self._statistics(envelope.sent_us)

    def outcome(self, outcome: Outcome) -> None:
        """The flight is over."""
        t_us = outcome.end_us
        self.closed = True
        self._statistics(t_us)
        self._log.write(
            "/mission/outcome",
            "skyhaul_msgs/Outcome",
            t_us,
            *messages.header(t_us),
            outcome.success,
            outcome.reason,
            outcome.wall_s,
            list(outcome.cpu_s),
            list(outcome.cpu_s.values()),
        )

    def _statistics(self, t_us: TimeUs) -> None:
        self._statistics_us = t_us
        topics = sorted(self._counts)
        self._log.write(
            "/comms/statistics",
            "skyhaul_msgs/CommsStatistics",
            t_us,
            *messages.header(t_us),
            self._counts.total(),
            self._bytes.total(),
            topics,
            [self._counts[k] for k in topics],
            [self._bytes[k] for k in topics],
        )

    def _voxel_delta(self, t_us: TimeUs, world_map: WorldMap) -> None:
        grid, old = world_map.grid, self._voxels
        same = old.shape == grid.occupied.shape and np.array_equal(self._p_WO, grid.p_WO)
        now = grid.occupied
        added = np.flatnonzero(now & ~old if same else now)
        freed = np.flatnonzero(old & ~now) if same else np.zeros(0, dtype=np.int64)
        self._voxels, self._p_WO = now.copy(), np.array(grid.p_WO)
        self._log.write(
            "/map/voxels",
            "skyhaul_msgs/VoxelDelta",
            t_us,
            *messages.header(t_us),
            *grid.p_WO.tolist(),
            grid.voxel_m,
            now.shape,
            world_map.version,
            not same,
            added,
            freed,
        )


def _is_lost(body: str, truth: Truth) -> bool:
    """Whether a contact's body is a vehicle whose rotors stopped, or its cable."""
    kind, _, index = body.partition(" ")
    if kind not in ("vehicle", "cable") or not index.isdigit():
        return False
    return not truth.alive[int(index)]
