# SPDX-License-Identifier: Apache-2.0
"""Keyframes: when one is due, what it holds, and the index in which its place is looked up."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from skyhaul.geometry.camera import CameraArrays
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.so3 import so3_log
from skyhaul.params import Params
from skyhaul.perception.slam.places import NO_CORNERS, Corners, Place, corners_of, points_of
from skyhaul.perception.slam.words import Descriptors, PlaceIndex, train_words
from skyhaul.perception.vio.api import VioEstimate
from skyhaul.perception.vio.front_end import Followed
from skyhaul.types import US_PER_S, Array

LEARN_FROM = 1500
"""Descriptors from which words are learnt, about."""


@dataclass(frozen=True, kw_only=True)
class KeyframeRules(Params):
    """When keyframes are made, and what they hold."""

    keyframe_m: float = 0.5
    """Way from keyframe to keyframe [m] ..."""
    keyframe_deg: float = 15.0
    """... or turn [deg]; while it is slow: ..."""
    slow_s: float = 1.0
    """... time [s] ..."""
    slow_m: float = 0.1
    """... in which it moves by this at least [m]."""
    corners: int = 120
    """Corners of a camera's image that are described."""
    spacing_px: int = 8
    """Least distance of two of them [px]."""
    words: int = 256
    """Size of the vocabulary, which is learnt from the first keyframes."""
    learn_from: int = 8
    """So many keyframes."""
    most_places: int = 4000
    """Keyframes that are kept; when they are full the map no longer grows."""

    def __post_init__(self) -> None:
        for name in ("keyframe_m", "keyframe_deg"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")
        for name in ("corners", "words", "learn_from", "most_places"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")

    def moved(self, last: Place, estimate: VioEstimate) -> bool:
        """Whether the vehicle has come far enough since a keyframe for the next one."""
        x = estimate.state
        assert x is not None, "asked for before"
        turn = np.linalg.norm(so3_log(last.R_WI.T @ quat_to_R(x.q_WI)))
        way = float(np.linalg.norm(x.p_WI - last.p_WI))
        slow = estimate.stamp_us - last.stamp_us >= round(self.slow_s * US_PER_S)
        moved = way >= self.keyframe_m or (slow and way >= self.slow_m)
        return moved or float(turn) >= math.radians(self.keyframe_deg)


class Look(Protocol):
    """What a rig sees at one time; worked out when it is asked for."""

    def corners(self) -> Corners:
        """Corners of all cameras."""
        ...

    def points(self, R_WI: Array, p_WI: Array) -> tuple[Array, Descriptors]:
        """Points known in depth, body axes, (m, 3) [m], and their descriptors, (m, 32)."""
        ...


@dataclass(frozen=True, eq=False)
class CameraLook:
    """A look through cameras; see `Look`."""

    rules: KeyframeRules
    lenses: Sequence[CameraArrays]
    views: Sequence[Followed | None]
    """What the front end follows in each camera."""
    landmarks: Callable[[], Mapping[int, Array]]
    """Points of its tracks, W axes, (3,) [m] each."""

    def corners(self) -> Corners:
        """See `Look.corners`."""
        return corners_of(self.lenses, self.views, self.rules.corners, self.rules.spacing_px)

    def points(self, R_WI: Array, p_WI: Array) -> tuple[Array, Descriptors]:
        """See `Look.points`."""
        return points_of(self.views, self.landmarks(), R_WI, p_WI)


def place_of(estimate: VioEstimate, look: Look) -> Place:
    """The keyframe of an estimate that has a state."""
    x = estimate.state
    assert x is not None, "asked for before"
    R_WI = quat_to_R(x.q_WI)
    points, descriptor = look.points(R_WI, x.p_WI)
    covariance = estimate.covariance[:6, :6].copy()
    return Place(
        estimate.stamp_us, R_WI, x.p_WI.copy(), covariance, look.corners(), points, descriptor
    )


def indexed(
    rules: KeyframeRules, index: PlaceIndex | None, places: tuple[Place, ...]
) -> tuple[PlaceIndex | None, tuple[Place, ...]]:
    """Put the newest place into the index; make the index once there are enough.

    What a place looks like is in the index then, and is no longer kept itself.
    """
    if index is not None:
        index = index.add(places[-1].corners.descriptor)
        return index, (*places[:-1], _bare(places[-1]))
    seen = [p.corners.descriptor for p in places]
    if len(seen) < rules.learn_from or not sum(map(len, seen)):
        return None, places
    every = max(1, sum(map(len, seen)) // LEARN_FROM)
    words = train_words(np.concatenate(seen)[::every], rules.words, seed=0, rounds=4)
    index = PlaceIndex(words)
    for rows in seen:
        index = index.add(rows)
    return index, tuple(_bare(p) for p in places)


def _bare(place: Place) -> Place:
    """A place without what the index holds of it."""
    return replace(place, corners=NO_CORNERS)
