# SPDX-License-Identifier: Apache-2.0
"""After `LOST`: where is the vehicle on its own map of places? The odometry goes on from there.

While the odometry tracks, its keyframes become places. Once it was `LOST` it is astray: dead
reckoning has drifted, and that stays in when landmarks return. It looks then for the place of now
among those that are known clearly better. What it finds counts when geometry agrees, when the
odometry may have drifted so far by its covariance, and when the next try says the same.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skyhaul.geometry.camera import CameraArrays
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import so3_log
from skyhaul.params import Params
from skyhaul.perception.slam.closure import Closure, ClosureRules, close
from skyhaul.perception.slam.found_pose import (
    POSE,
    found_pose,
    off_by,
    shared,
    without_drift,
)
from skyhaul.perception.slam.keyframes import CameraLook, KeyframeRules, Look, indexed, place_of
from skyhaul.perception.slam.places import Corners, Place
from skyhaul.perception.slam.pose_graph import correction
from skyhaul.perception.slam.words import PlaceIndex
from skyhaul.perception.vio.api import (
    CameraRig,
    Memory,
    NavState,
    VioEstimate,
    VioEstimator,
    VioStatus,
)
from skyhaul.perception.vio.front_end import Followed
from skyhaul.types import US_PER_S, Array, TimeUs


@dataclass(frozen=True, kw_only=True)
class Relocation(Params):
    """When a vehicle that was lost looks for its place, and what it must find."""

    keyframes: KeyframeRules = field(default_factory=KeyframeRules)
    """The map."""
    every_s: float = 0.3
    """Time from try to try [s]."""
    candidates: int = 8
    """Places that are checked in a try, the most alike."""
    gain: float = 0.4
    """A place helps when it leaves less than this share of the variance of the position; the team's
    filter takes a fall to less than a half for a new frame of the vehicle."""
    most_nees: float = 22.5
    """Square of the error found over its covariance, 6 degrees of freedom: 99.9 % are below."""
    floor_m: float = 0.1
    """Added to that covariance: standard deviation of the position, per axis [m] ..."""
    floor_deg: float = 0.5
    """... and of the attitude [deg]."""
    agree_s: float = 1.0
    """Two tries must say the same within this time [s] ..."""
    agree_m: float = 0.1
    """... within this and four standard deviations of the drift between them [m] ..."""
    agree_deg: float = 2.0
    """... and this [deg]."""
    closure: ClosureRules = field(default_factory=ClosureRules)
    """When two places are one."""

    def __post_init__(self) -> None:
        for name in ("every_s", "most_nees", "floor_m", "floor_deg", "agree_s", "agree_m"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        if not 0.0 < self.gain < 1.0:
            raise ValueError(f"gain must lie between 0 and 1, got {self.gain}")
        if self.candidates < 1:
            raise ValueError(f"candidates must be >= 1, got {self.candidates}")

    def build(self, rig: CameraRig, lenses: Sequence[CameraArrays]) -> "Relocaliser":
        """The relocaliser of a rig."""
        return Relocaliser(self, rig, tuple(lenses))


@dataclass(frozen=True, eq=False)
class Fix:
    """A place that was recognised, and the estimate then."""

    place: int
    closure: Closure
    estimate: VioEstimate
    R_MW: Array  # (3, 3) what it says of the odometry's frame
    p_MW: Array  # (3,) [m]


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """What the relocaliser remembers."""

    places: tuple[Place, ...] = ()
    index: PlaceIndex | None = None
    last: Place | None = None  # keyframe, with points or without
    astray_us: TimeUs | None = None  # since when; None: the odometry holds
    tried_us: TimeUs = 0
    waiting: Fix | None = None  # until another try agrees


@dataclass(frozen=True, eq=False)
class Relocaliser:
    """At work; build it with `Relocation.build`. Deterministic, stateful through its memory."""

    rules: Relocation
    rig: CameraRig
    lenses: tuple[CameraArrays, ...]

    def init(self) -> LandmarkMap:
        """An empty map."""
        return LandmarkMap()

    def follow(
        self,
        places: LandmarkMap,
        estimator: VioEstimator[Memory],
        memory: Memory,
        estimate: VioEstimate,
        views: Sequence[Followed | None],
    ) -> tuple[LandmarkMap, Memory, VioEstimate]:
        """Map what the odometry sees; where a place takes its drift out, it goes on from there.

        Args:
            places: What `init` or the last `follow` returned.
            estimator: The odometry.
            memory: Its memory after `step`.
            estimate: What that returned.
            views: What its front end follows in each camera.
        """
        look = CameraLook(
            self.rules.keyframes, self.lenses, views, lambda: estimator.landmarks(memory)
        )
        places, found = self.step(places, estimate, look)
        if found is None:
            return places, memory, estimate
        state, covariance = found
        estimate = replace(
            estimate,
            status=VioStatus.TRACKING,
            state=state,
            covariance=covariance,
            relocated=True,
        )
        return places, estimator.restart(memory, state, covariance), estimate

    def step(
        self, memory: LandmarkMap, estimate: VioEstimate, look: Look
    ) -> tuple[LandmarkMap, tuple[NavState, Array] | None]:
        """Take an estimate in: the map, and state and covariance where it was relocated."""
        if estimate.state is None:
            return memory, None
        lost = estimate.status is VioStatus.LOST
        if lost and memory.astray_us is None:
            memory = replace(memory, astray_us=estimate.stamp_us)
        if memory.astray_us is not None:
            memory, found = self._seek(memory, estimate, look)
            if found is not None:
                return memory, found
        return (memory if lost else self._mapped(memory, estimate, look)), None

    def _mapped(self, memory: LandmarkMap, estimate: VioEstimate, look: Look) -> LandmarkMap:
        """The map with a place of now where one is due and there are points to find it by."""
        rules, last = self.rules.keyframes, memory.last
        full = len(memory.places) >= rules.most_places
        if full or (last is not None and not rules.moved(last, estimate)):
            return memory
        place = place_of(estimate, look)
        memory = replace(memory, last=place)
        if len(place.p_IP) < self.rules.closure.least_inliers:
            return memory
        index, places = indexed(rules, memory.index, (*memory.places, place))
        return replace(memory, index=index, places=places)

    def _seek(
        self, memory: LandmarkMap, estimate: VioEstimate, look: Look
    ) -> tuple[LandmarkMap, tuple[NavState, Array] | None]:
        """Look for the place of now where a try is due."""
        every_us = round(self.rules.every_s * US_PER_S)
        helpful = self._helpful(memory, estimate)
        if not helpful or estimate.stamp_us < memory.tried_us + every_us:
            return memory, None
        memory = replace(memory, tried_us=estimate.stamp_us)
        corners = look.corners()
        if len(corners.descriptor) < self.rules.closure.least_inliers:
            return memory, None
        fix = self._recognise(memory, estimate, corners, helpful)
        if fix is None:
            return memory, None
        before = memory.waiting
        if before is None or not self._agree(before, fix):
            return replace(memory, waiting=fix), None
        return self._relocated(memory, estimate, fix)

    def _relocated(
        self, memory: LandmarkMap, estimate: VioEstimate, fix: Fix
    ) -> tuple[LandmarkMap, tuple[NavState, Array] | None]:
        """Take the drift out; the vehicle is no longer astray if it was not when it was there."""
        place, x = memory.places[fix.place], estimate.state
        assert x is not None, "asked for before"
        assert memory.astray_us is not None, "asked for before"
        state, covariance = without_drift(x, estimate.covariance, place, fix.closure)
        if not _spread(covariance) < self.rules.gain * _spread(estimate.covariance):
            return replace(memory, waiting=fix), None
        home = place.stamp_us <= memory.astray_us
        astray_us = None if home else memory.astray_us
        return replace(memory, astray_us=astray_us, waiting=None, last=None), (state, covariance)

    def _helpful(self, memory: LandmarkMap, estimate: VioEstimate) -> frozenset[int]:
        """Places whose position is known clearly better than that of now."""
        floor = 3.0 * self.rules.closure.floor_m**2
        most = self.rules.gain * _spread(estimate.covariance) - floor
        return frozenset(i for i, p in enumerate(memory.places) if _spread(p.covariance) < most)

    def _recognise(
        self, memory: LandmarkMap, estimate: VioEstimate, now: Corners, among: frozenset[int]
    ) -> Fix | None:
        """Of the places that are most alike and stand all checks that which tells most exactly."""
        rules, index, x = self.rules, memory.index, estimate.state
        assert x is not None, "asked for before"
        order = sorted(among, reverse=True)
        if index is not None:
            alike = index.query(now.descriptor, len(memory.places), len(memory.places))
            order = [c.place for c in alike if c.place in among][: rules.candidates]
        found = []
        for i in order:
            place = memory.places[i]
            closure = close(rules.closure, self.rig, self.lenses[0].fx, place, now)
            if closure is None:
                continue
            known = shared(place, x, closure).covariance
            if self._possible(estimate, found_pose(place, closure), known):
                found.append((_spread(known), i, closure))
        if not found:
            return None
        _, i, closure = min(found, key=lambda f: f[:2])
        return _fix(i, memory.places[i], estimate, closure)

    def _possible(self, estimate: VioEstimate, pose: tuple[Array, Array], known: Array) -> bool:
        """Whether the odometry may have drifted as far as a pose says that was found."""
        rules, x = self.rules, estimate.state
        assert x is not None, "asked for before"
        floor = np.repeat([rules.floor_m**2, math.radians(rules.floor_deg) ** 2], 3)
        S = estimate.covariance[POSE, POSE] + known + np.diag(floor)
        z = off_by(x, pose)
        return float(z @ np.linalg.solve(S, z)) <= rules.most_nees

    def _agree(self, a: Fix, b: Fix) -> bool:
        """Whether two tries say the same of now."""
        rules, then, now = self.rules, a.estimate, b.estimate
        assert now.state is not None, "asked for before"
        if now.stamp_us - then.stamp_us > round(rules.agree_s * US_PER_S):
            return False
        here = now.state.p_WI
        off = float(np.linalg.norm((a.R_MW @ here + a.p_MW) - (b.R_MW @ here + b.p_MW)))
        turn = float(np.linalg.norm(so3_log(a.R_MW.T @ b.R_MW)))
        grown = max(0.0, _spread(now.covariance) - _spread(then.covariance))
        most = rules.agree_m + 4.0 * math.sqrt(grown)
        return off <= most and turn <= math.radians(rules.agree_deg)


def _fix(i: int, place: Place, estimate: VioEstimate, closure: Closure) -> Fix:
    x = estimate.state
    assert x is not None, "asked for before"
    held = (quat_to_R(x.q_WI), x.p_WI)
    return Fix(i, closure, estimate, *correction(held, found_pose(place, closure)))


def _spread(covariance: Array) -> float:
    """Variance of the position, all axes together [m^2]."""
    return float(np.trace(covariance[:3, :3]))
