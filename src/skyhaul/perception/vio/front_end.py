# SPDX-License-Identifier: Apache-2.0
"""From images to feature tracks: corners, optical flow with a way back, epipolar check."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from skyhaul.geometry.camera import CameraModel, project_points, unproject_pixels
from skyhaul.params import Params
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.sensors.api import CameraFrame, GreyImage
from skyhaul.types import Array, IntArray, Mask, TimeUs

LEAST_DEPTH = 0.25
"""Rays flatter than this (cosine to the camera's axis) have no normalised image that helps."""


@dataclass(frozen=True, kw_only=True)
class FrontEnd(Params):
    """Corners followed by pyramidal Lucas-Kanade in every camera."""

    detector: Literal["gftt", "fast"] = "gftt"
    """Corners: by the smaller eigenvalue (Shi and Tomasi), or FAST."""
    features: int = 120
    """Corners that are followed, over all cameras."""
    spacing_px: int = 15
    """Least distance of two corners of a camera [px]."""
    quality: float = 0.01
    """GFTT: weakest corner as a share of the strongest."""
    fast_threshold: int = 20
    """FAST: difference of grey values."""
    window_px: int = 21
    """Side of the patch that is followed [px]."""
    levels: int = 3
    """Levels of the image pyramid above the image."""
    back_px: float = 0.7
    """A corner followed forth and back must come home within this [px]."""
    epipolar_px: float = 1.5
    """Error of the epipolar constraint that RANSAC allows [px]."""

    def __post_init__(self) -> None:
        for name in ("features", "spacing_px", "window_px", "fast_threshold"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")
        for name in ("back_px", "epipolar_px", "quality"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def build(self, models: Sequence[CameraModel], rig: CameraRig) -> "FeatureTracker":
        """The tracker of a rig."""
        return FeatureTracker(self, tuple(models), rig)


@dataclass(frozen=True, eq=False)
class Followed:
    """What one camera follows."""

    image: GreyImage
    uv: Array  # (k, 2) [px]
    track_id: IntArray  # (k,)


@dataclass(frozen=True, eq=False)
class TrackerMemory:
    """What the tracker remembers."""

    cameras: tuple[Followed | None, ...]
    next_id: int = 0


@dataclass(frozen=True, eq=False)
class FeatureTracker:
    """Follows corners from frame to frame of every camera."""

    params: FrontEnd
    models: tuple[CameraModel, ...]
    rig: CameraRig

    def init(self) -> TrackerMemory:
        """Memory before the first image."""
        return TrackerMemory((None,) * len(self.models))

    def step(
        self, memory: TrackerMemory, frames: Sequence[CameraFrame], stamp_us: TimeUs, R_turn: Array
    ) -> tuple[TrackerMemory, TrackFrame]:
        """Follow all corners into new images, find new ones, hand the tracks on.

        Args:
            memory: What `init` or the last `step` returned.
            frames: One image of each camera that has one now.
            stamp_us: Their time.
            R_turn: Turn of the body since the images before, R_before_now, from the gyroscope: it
                predicts where corners are now.
        """
        cameras, next_id, rows = list(memory.cameras), memory.next_id, []
        for frame in frames:
            before = cameras[frame.camera]
            now = self._follow(frame, before, R_turn)
            now, next_id = self._fill(frame, now, next_id)
            cameras[frame.camera] = now
            xy, good = self._normalized(frame.camera, now.uv)
            ids = now.track_id[good]
            rows.append((ids, np.full(len(ids), frame.camera, dtype=np.int64), xy[good]))
        ids, camera, xy = (
            (np.concatenate([r[i] for r in rows]) for i in range(3))
            if rows
            else (
                np.zeros(0, dtype=np.int64),
                np.zeros(0, dtype=np.int64),
                np.zeros((0, 2)),
            )
        )
        memory = replace(memory, cameras=tuple(cameras), next_id=next_id)
        return memory, TrackFrame(stamp_us, ids, camera, xy)

    def _follow(self, frame: CameraFrame, before: Followed | None, R_turn: Array) -> Followed:
        """Corners of the image before in the new one, without those that are lost."""
        if before is None or len(before.uv) == 0:
            return Followed(frame.image, np.zeros((0, 2)), np.zeros(0, dtype=np.int64))
        guess = self._predicted(frame.camera, before.uv, R_turn)
        uv, found = self._flow(before.image, frame.image, before.uv, guess)
        home, back = self._flow(frame.image, before.image, uv, before.uv)
        returned = np.linalg.norm(home - before.uv, axis=1) <= self.params.back_px
        w, h = self.models[frame.camera].size_px
        inside = np.all((uv >= 1.0) & (uv <= np.array([w, h]) - 2.0), axis=1)
        kept = found & back & returned & inside
        uv, ids, old = uv[kept], before.track_id[kept], before.uv[kept]
        agree = self._epipolar(frame.camera, old, uv)
        return Followed(frame.image, uv[agree], ids[agree])

    def _predicted(self, camera: int, uv: Array, R_turn: Array) -> Array:
        """Where corners would be if the body had only turned, (k, 2) [px]."""
        R_IC = self.rig.R_IC[camera]
        rays = unproject_pixels(self.models[camera], uv) @ (R_IC.T @ R_turn @ R_IC)
        ahead, ok = project_points(self.models[camera], rays)
        return np.where(ok[:, None], ahead, uv)

    def _flow(self, a: GreyImage, b: GreyImage, uv: Array, guess: Array) -> tuple[Array, Mask]:
        side = self.params.window_px
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            a,
            b,
            uv.astype(np.float32).reshape(-1, 1, 2),
            guess.astype(np.float32).reshape(-1, 1, 2).copy(),
            winSize=(side, side),
            maxLevel=self.params.levels,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(moved, dtype=np.float64).reshape(-1, 2), np.ravel(status) == 1

    def _epipolar(self, camera: int, before: Array, now: Array) -> Mask:
        """Which pairs agree with one motion of the camera; with few of them all do."""
        every = np.ones(len(now), dtype=np.bool_)
        a, good_a = self._normalized(camera, before)
        b, good_b = self._normalized(camera, now)
        both = good_a & good_b
        if np.count_nonzero(both) < 10:
            return every
        threshold = self.params.epipolar_px / self.models[camera].focal_px[0]
        cv2.setRNGSeed(0)
        E, mask = cv2.findEssentialMat(
            a[both], b[both], np.eye(3), method=cv2.RANSAC, prob=0.99, threshold=threshold
        )
        if E is None or mask is None:
            return every
        agree = every.copy()
        agree[both] = np.ravel(mask) == 1
        return agree if np.count_nonzero(agree) >= 0.5 * len(agree) else every

    def _fill(self, frame: CameraFrame, now: Followed, next_id: int) -> tuple[Followed, int]:
        """Add corners where there are none."""
        wanted = self.params.features // len(self.models) - len(now.uv)
        if wanted <= 0:
            return now, next_id
        free = np.full(frame.image.shape, 255, dtype=np.uint8)
        for u, v in np.round(now.uv).astype(int):
            cv2.circle(free, (int(u), int(v)), self.params.spacing_px, 0, -1)
        fresh = self._corners(frame.image, free, wanted)
        ids = np.arange(next_id, next_id + len(fresh), dtype=np.int64)
        both = Followed(
            frame.image, np.vstack([now.uv, fresh]), np.concatenate([now.track_id, ids])
        )
        return both, next_id + len(fresh)

    def _corners(self, image: GreyImage, free: GreyImage, count: int) -> Array:
        p = self.params
        if p.detector == "gftt":
            found = cv2.goodFeaturesToTrack(image, count, p.quality, p.spacing_px, mask=free)
            return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
        points = cv2.FastFeatureDetector.create(p.fast_threshold).detect(image, free)
        kept: list[Array] = []
        for point in sorted(points, key=lambda c: (-c.response, c.pt)):
            at = np.array(point.pt)
            if all(np.linalg.norm(at - other) >= p.spacing_px for other in kept):
                kept.append(at)
            if len(kept) == count:
                break
        return np.array(kept).reshape(-1, 2)

    def _normalized(self, camera: int, uv: Array) -> tuple[Array, Mask]:
        """Normalised images and which of them are of use, (k, 2) and (k,)."""
        rays = unproject_pixels(self.models[camera], uv)
        good: Mask = rays[:, 2] > LEAST_DEPTH
        return rays[:, :2] / np.maximum(rays[:, 2:], LEAST_DEPTH), good
