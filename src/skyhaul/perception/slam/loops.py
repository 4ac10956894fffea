# SPDX-License-Identifier: Apache-2.0
"""Closing loops: keyframes, places seen again, a graph of poses, and where the odometry is off.

The odometry itself is never touched: it stays smooth and causal. What comes out is the transform
T_MW that takes its frame W to the map's frame M, which is W at the start. A closure counts when the
place looks alike, when geometry agrees, when it is not further off than the odometry may have
drifted, and when the next keyframe's closure says the same; in the graph it is robust still.

While the odometry is LOST it dead-reckons with a growing covariance and keyframes go on by time:
a place that is recognised then takes the drift out of T_MW at once.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyhaul.geometry.camera import CameraArrays
from skyhaul.geometry.quaternion import R_to_quat, quat_mul
from skyhaul.geometry.so3 import hat, so3_log
from skyhaul.params import Params
from skyhaul.perception.slam.closure import Closure, ClosureRules, close
from skyhaul.perception.slam.keyframes import CameraLook, KeyframeRules, indexed, place_of
from skyhaul.perception.slam.places import Place
from skyhaul.perception.slam.pose_graph import Relation, correction, optimize_poses
from skyhaul.perception.slam.words import PlaceIndex
from skyhaul.perception.vio.api import CameraRig, NavState, VioEstimate, VioStatus
from skyhaul.perception.vio.front_end import Followed
from skyhaul.types import US_PER_S, Array

LEAST_M, LEAST_RAD = 2e-3, 3e-4
"""Least standard deviation of the odometry from keyframe to keyframe."""


@dataclass(frozen=True, kw_only=True)
class LoopRules(Params):
    """When keyframes are made, and what a loop must show."""

    keyframes: KeyframeRules = field(default_factory=KeyframeRules)
    """When keyframes are made, and what they hold."""
    lost_s: float = 0.5
    """While the odometry is LOST: time from keyframe to keyframe [s]."""
    least_gap_s: float = 8.0
    """Places left less than this long ago are not looked for [s]."""
    candidates: int = 3
    """Places that are checked at a keyframe, the most alike."""
    odometry_m_per_sqrt_m: float = 0.02
    """The odometry drifts at least so much in each axis per square root of the way, whatever its
    covariance says ..."""
    odometry_deg_per_sqrt_m: float = 0.1
    """... and turns so much [deg]."""
    drift_m: float = 0.1
    """A loop may be off by this [m] ..."""
    drift_sigmas: float = 4.0
    """... and so many standard deviations of the odometry since."""
    agree_m: float = 0.1
    """Loops of successive keyframes must agree within this and the odometry's drift [m] ..."""
    agree_deg: float = 2.0
    """... and this [deg]."""
    closure: ClosureRules = field(default_factory=ClosureRules)
    """When two places are one."""

    def __post_init__(self) -> None:
        for name in ("lost_s", "least_gap_s", "agree_m", "agree_deg"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if self.candidates < 1:
            raise ValueError(f"candidates must be >= 1, got {self.candidates}")

    def build(self, rig: CameraRig, lenses: Sequence[CameraArrays]) -> "LoopCloser":
        """The loop closer of a rig."""
        return LoopCloser(self, rig, tuple(lenses))


@dataclass(frozen=True, eq=False)
class Found:
    """A place that was recognised."""

    loop: Relation
    R_MW: Array  # (3, 3) what it says of the odometry's frame
    p_MW: Array  # (3,) [m]


@dataclass(frozen=True, eq=False)
class LoopMemory:
    """The map so far."""

    places: tuple[Place, ...] = ()
    graph_R: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))  # R_MI of the places
    graph_p: Array = field(default_factory=lambda: np.zeros((0, 3)))  # p_MI [m]
    odometry: tuple[Relation, ...] = ()
    loops: tuple[Relation, ...] = ()
    index: PlaceIndex | None = None
    waiting: Found | None = None  # until the next keyframe agrees
    R_MW: Array = field(default_factory=lambda: np.eye(3))
    p_MW: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False)
class LoopCloser:
    """At work; build it with `LoopRules.build`. Deterministic, stateful through its memory."""

    rules: LoopRules
    rig: CameraRig
    lenses: tuple[CameraArrays, ...]

    def init(self) -> LoopMemory:
        """An empty map."""
        return LoopMemory()

    def due(self, memory: LoopMemory, estimate: VioEstimate) -> bool:
        """Whether an estimate makes a keyframe."""
        rules = self.rules
        if estimate.state is None or len(memory.places) >= rules.keyframes.most_places:
            return False
        if not memory.places:
            return True
        last = memory.places[-1]
        if estimate.status is VioStatus.LOST:
            return estimate.stamp_us - last.stamp_us >= round(rules.lost_s * US_PER_S)
        return rules.keyframes.moved(last, estimate)

    def step(
        self,
        memory: LoopMemory,
        estimate: VioEstimate,
        views: Sequence[Followed | None],
        landmarks: Mapping[int, Array],
    ) -> LoopMemory:
        """Add a keyframe, look for its place, close the loop; call it where `due` says so.

        Args:
            memory: What `init` or the last `step` returned.
            estimate: Of the odometry.
            views: What its front end follows in each camera.
            landmarks: Points of its tracks, W axes, (3,) [m] each.
        """
        look = CameraLook(self.rules.keyframes, self.lenses, views, lambda: landmarks)
        return self.add(memory, place_of(estimate, look))

    def add(self, memory: LoopMemory, place: Place) -> LoopMemory:
        """Add a place, look for it among those before, close the loop."""
        memory = self._appended(memory, place)
        found = self._recognise(memory, place)
        index, places = indexed(self.rules.keyframes, memory.index, memory.places)
        return self._closed(replace(memory, index=index, places=places), found)

    def _appended(self, memory: LoopMemory, place: Place) -> LoopMemory:
        """The map with one more place, joined to the one before by the odometry."""
        R_MI, p_MI = memory.R_MW @ place.R_WI, memory.R_MW @ place.p_WI + memory.p_MW
        odometry, n = memory.odometry, len(memory.places)
        if n:
            odometry = (*odometry, _between(self.rules, n - 1, memory.places[-1], place))
        return replace(
            memory,
            places=(*memory.places, place),
            graph_R=np.concatenate([memory.graph_R, R_MI[None]]),
            graph_p=np.concatenate([memory.graph_p, p_MI[None]]),
            odometry=odometry,
        )

    def _recognise(self, memory: LoopMemory, now: Place) -> Found | None:
        """The place of before that is most alike and stands all checks."""
        rules = self.rules
        if memory.index is None:
            return None
        left_us = now.stamp_us - round(rules.least_gap_s * US_PER_S)
        before = sum(p.stamp_us <= left_us for p in memory.places)
        j, focal = len(memory.places) - 1, self.lenses[0].fx
        for candidate in memory.index.query(now.corners.descriptor, before, rules.candidates):
            i = candidate.place
            closure = close(rules.closure, self.rig, focal, memory.places[i], now.corners)
            if closure is not None and self._possible(memory, i, closure):
                return _found(memory, i, j, closure)
        return None

    def _possible(self, memory: LoopMemory, i: int, closure: Closure) -> bool:
        """Whether the odometry may have drifted as far as a closure says."""
        j = len(memory.places) - 1
        p_M = memory.graph_p[i] + memory.graph_R[i] @ closure.p
        off = float(np.linalg.norm(p_M - memory.graph_p[j]))
        return off <= self.rules.drift_m + self._drift_m(memory, i, j)

    def _drift_m(self, memory: LoopMemory, i: int, j: int) -> float:
        """How far the odometry may have drifted from place i to j, by its own covariance [m]."""
        grown = memory.places[j].covariance[:3, :3] - memory.places[i].covariance[:3, :3]
        return self.rules.drift_sigmas * math.sqrt(max(float(np.trace(grown)), 0.0))

    def _closed(self, memory: LoopMemory, found: Found | None) -> LoopMemory:
        """Close the loop when the keyframe before saw the same; else wait for the next.

        The graph is solved from where the closures put their keyframes: from further off, their
        robust kernel would leave them no weight.
        """
        before = memory.waiting
        if found is None or before is None or not self._agree(memory, before, found):
            return replace(memory, waiting=found)
        loops = (*memory.loops, before.loop, found.loop)
        loops = tuple({(r.i, r.j): r for r in loops}.values())
        R, p = memory.graph_R.copy(), memory.graph_p.copy()
        for seen in (before, found):
            place = memory.places[seen.loop.j]
            R[seen.loop.j] = seen.R_MW @ place.R_WI
            p[seen.loop.j] = seen.R_MW @ place.p_WI + seen.p_MW
        R, p = optimize_poses((R, p), memory.odometry, loops)
        last = memory.places[-1]
        R_MW, p_MW = correction((last.R_WI, last.p_WI), (R[-1], p[-1]))
        return replace(
            memory, graph_R=R, graph_p=p, loops=loops, waiting=found, R_MW=R_MW, p_MW=p_MW
        )

    def _agree(self, memory: LoopMemory, a: Found, b: Found) -> bool:
        """Whether two closures say the same of the newest place."""
        here = memory.places[-1].p_WI
        off = (a.R_MW @ here + a.p_MW) - (b.R_MW @ here + b.p_MW)
        turn = float(np.linalg.norm(so3_log(a.R_MW.T @ b.R_MW)))
        most = self.rules.agree_m + self._drift_m(memory, a.loop.j, b.loop.j)
        near = float(np.linalg.norm(off)) <= most
        return near and turn <= math.radians(self.rules.agree_deg)


def on_map(memory: LoopMemory, state: NavState) -> tuple[Array, Array]:
    """Position (3,) [m] and attitude (4,) of a state of the odometry in the map's frame."""
    q_MI = quat_mul(R_to_quat(memory.R_MW), state.q_WI)
    return memory.R_MW @ state.p_WI + memory.p_MW, q_MI


def _between(rules: LoopRules, i: int, a: Place, b: Place) -> Relation:
    """The odometry from place i to the next, with what its covariance grew by.

    Errors as right perturbations: S_b = Ad S_a Ad^T + Q, with Ad that of T_ab^-1. What became
    better meanwhile is taken as unchanged, and drift that a filter cannot know of is added.
    """
    R_ab = a.R_WI.T @ b.R_WI
    p_ab = a.R_WI.T @ (b.p_WI - a.p_WI)
    Ad = np.zeros((6, 6))
    Ad[:3, :3] = Ad[3:, 3:] = R_ab.T
    Ad[:3, 3:] = -R_ab.T @ hat(p_ab)
    Q = _in_body(b) - Ad @ _in_body(a) @ Ad.T
    values, vectors = np.linalg.eigh(0.5 * (Q + Q.T))
    Q = vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
    way = float(np.linalg.norm(p_ab))
    drift = np.array([rules.odometry_m_per_sqrt_m, math.radians(rules.odometry_deg_per_sqrt_m)])
    least = np.array([LEAST_M, LEAST_RAD])
    return Relation(i, i + 1, R_ab, p_ab, Q + np.diag(np.repeat(least**2 + drift**2 * way, 3)))


def _in_body(place: Place) -> Array:
    """Covariance of a place's error (p, R), both in axes of the body."""
    turn = np.eye(6)
    turn[:3, :3] = place.R_WI.T
    covariance: Array = turn @ place.covariance @ turn.T
    return covariance


def _found(memory: LoopMemory, i: int, j: int, closure: Closure) -> Found:
    """A closure as a relation of the graph, and as what it says of the odometry's frame."""
    R_M = memory.graph_R[i] @ closure.R
    p_M = memory.graph_p[i] + memory.graph_R[i] @ closure.p
    now = memory.places[j]
    R_MW, p_MW = correction((now.R_WI, now.p_WI), (R_M, p_M))
    return Found(Relation(i, j, closure.R, closure.p, closure.covariance), R_MW, p_MW)
