# SPDX-License-Identifier: Apache-2.0
"""From images to feature tracks: corners, optical flow with a way back, epipolar check."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np

from skyhaul.geometry.camera import CameraModel
from skyhaul.params import Params
from skyhaul.perception.vio.api import CameraRig, TrackFrame
from skyhaul.perception.vio.corners import Detector, find_corners
from skyhaul.perception.vio.epipolar import five_point, matches_agree, one_translation
from skyhaul.perception.vio.rays import project_rays, rays_of
from skyhaul.sensors.api import CameraFrame, GreyImage
from skyhaul.types import Array, IntArray, Mask, TimeUs

LEAST_DEPTH = 0.25
"""Rays flatter than this (cosine to the camera's axis) have no normalised image that helps."""
FEW = 10
"""With fewer pairs than this no motion is sought: all of them agree."""


@dataclass(frozen=True, kw_only=True)
class FrontEnd(Params):
    """Corners followed by pyramidal Lucas-Kanade in every camera."""

    detector: Detector = "gftt"
    """Corners: by the smaller eigenvalue (Shi and Tomasi, gftt), fast, orb or sift."""
    features: int = 120
    """Corners that are followed, over all cameras."""
    spacing_px: int = 15
    """Least distance of two corners of a camera [px]."""
    quality: float = 0.01
    """GFTT: weakest corner as a share of the strongest."""
    fast_threshold: int = 20
    """FAST and ORB: difference of grey values."""
    window_px: int = 21
    """Side of the patch that is followed [px]."""
    levels: int = 3
    """Levels of the image pyramid above the image."""
    renew_frames: int = 5
    """Patches are followed from an image that is renewed after so many, so that errors do not add
    up from image to image."""
    renew_share: float = 0.7
    """It is renewed earlier when less than this share of its corners is left."""
    back_px: float = 0.7
    """A corner followed forth and back must come home within this [px]."""
    epipolar_px: float = 1.5
    """Error of the epipolar constraint that RANSAC allows [px]."""
    motion: Literal["five-point", "gyro"] = "five-point"
    """What RANSAC seeks: turn and translation, or the translation alone with the gyroscope's turn;
    for that the gyroscope's bias must be known to some mrad/s."""
    overlap: float = 0.5
    """Two cameras that share this part of their views look for each other's corners."""

    def __post_init__(self) -> None:
        for name in ("features", "spacing_px", "window_px", "fast_threshold", "renew_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be >= 1, got {getattr(self, name)}")
        for name in ("back_px", "epipolar_px", "quality"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name)}")

    def build(self, models: Sequence[CameraModel], rig: CameraRig) -> "FeatureTracker":
        """The tracker of a rig."""
        lenses = tuple(m.arrays() for m in models)
        pairs = tuple(
            (a, b)
            for b in range(len(models))
            for a in range(b)
            if _overlap(models[a], models[b], rig, a, b) >= self.overlap
        )
        return FeatureTracker(self, tuple(models), rig, lenses, pairs)


def _overlap(a: CameraModel, b: CameraModel, rig: CameraRig, i: int, j: int) -> float:
    """Share of camera i's view that camera j sees too, far away."""
    w, h = a.size_px
    u, v = np.meshgrid(np.linspace(0.0, w - 1.0, 12), np.linspace(0.0, h - 1.0, 9))
    rays = rays_of(a.arrays(), np.column_stack([u.ravel(), v.ravel()]))
    seen, ok = project_rays(b.arrays(), rays @ (rig.R_IC[i].T @ rig.R_IC[j]))
    return float(np.mean(ok & _inside(b, seen)))


def _inside(model: CameraModel, uv: Array) -> Mask:
    """Which places are in the image, a pixel from its edge at least, (k,)."""
    inside: Mask = np.all((uv >= 1.0) & (uv <= np.array(model.size_px) - 2.0), axis=1)
    return inside


@dataclass(frozen=True, eq=False)
class Followed:
    """What one camera follows."""

    image: GreyImage
    uv: Array  # (k, 2) [px]
    track_id: IntArray  # (k,)
    anchor: GreyImage  # image that the patches are from
    anchor_uv: Array  # (k, 2) where they were in it [px]
    anchored: int  # corners that the anchor had
    age: int  # images since then
    R_anchor: Array = field(default_factory=lambda: np.eye(3))  # turn of the body since the anchor
    R_image: Array = field(default_factory=lambda: np.eye(3))  # and since the image


@dataclass(frozen=True, eq=False)
class TrackerMemory:
    """What the tracker remembers."""

    cameras: tuple[Followed | None, ...]
    next_id: int = 0

    def delivered_since(self, before: "TrackerMemory") -> tuple[Followed | None, ...]:
        """What the cameras follow that delivered an image since then; None for the others."""
        return tuple(
            None if now is None or (then is not None and now.image is then.image) else now
            for now, then in zip(self.cameras, before.cameras, strict=True)
        )


@dataclass(frozen=True, eq=False)
class FeatureTracker:
    """Follows corners from frame to frame of every camera."""

    params: FrontEnd
    models: tuple[CameraModel, ...]
    rig: CameraRig
    lenses: tuple[Any, ...]  # numbers of the models, as kernels take them
    pairs: tuple[tuple[int, int], ...]  # cameras that share most of their views

    def init(self) -> TrackerMemory:
        """Memory before the first image."""
        return TrackerMemory((None,) * len(self.models))

    def step(
        self, memory: TrackerMemory, frames: Sequence[CameraFrame], stamp_us: TimeUs, R_turn: Array
    ) -> tuple[TrackerMemory, TrackFrame]:
        """Follow all corners into new images, find new ones, hand the tracks on.

        An image that is the same byte for byte as the one before comes from a camera that hangs
        (real ones have noise): it counts as not delivered.

        Args:
            memory: What `init` or the last `step` returned.
            frames: One image of each camera that has one now.
            stamp_us: Their time.
            R_turn: Turn of the body since the frame before, R_before_now, from the gyroscope: it
                predicts where corners are now.
        """
        cameras = [_turned(c, R_turn) for c in memory.cameras]
        next_id, rows, here = memory.next_id, [], set()
        for frame in sorted(frames, key=lambda f: f.camera):
            c, before = frame.camera, cameras[frame.camera]
            if before is not None and np.array_equal(before.image, frame.image):
                continue
            now = self._follow(frame, before)
            if self._renewal_due(now):
                for a, b in self.pairs:
                    if b == c and a in here:
                        now = self._match(cameras[a], now, a, b)
                now, next_id = self._fill(now, next_id)
            cameras[c] = now
            here.add(c)
            rays = rays_of(self.lenses[c], now.uv)
            good = rays[:, 2] > LEAST_DEPTH
            ids, xy = now.track_id[good], rays[good, :2] / rays[good, 2:]
            rows.append((ids, np.full(len(ids), c, dtype=np.int64), xy))
        none = np.zeros(0, dtype=np.int64)
        rows = rows or [(none, none, np.zeros((0, 2)))]
        ids, camera, xy = (np.concatenate([r[i] for r in rows]) for i in range(3))
        memory = replace(memory, cameras=tuple(cameras), next_id=next_id)
        silent = tuple(c for c in range(len(self.models)) if c not in here)
        return memory, TrackFrame(stamp_us, ids, camera, xy, silent)

    def _follow(self, frame: CameraFrame, before: Followed | None) -> Followed:
        """Corners of the anchor in the new image, without those that are lost."""
        p, c = self.params, frame.camera
        if before is None or len(before.uv) == 0:
            none = np.zeros((0, 2))
            ids = np.zeros(0, dtype=np.int64)
            return Followed(frame.image, none, ids, frame.image, none, 0, p.renew_frames)
        guess = self._predicted(c, before.uv, before.R_image)
        uv, found = self._flow(before.anchor, frame.image, before.anchor_uv, guess, p.levels)
        home, back = self._flow(frame.image, before.anchor, uv, before.anchor_uv, 0)
        returned = np.linalg.norm(home - before.anchor_uv, axis=1) <= p.back_px
        kept = found & back & returned & _inside(self.models[c], uv)
        kept[kept] = self._epipolar(c, before.anchor_uv[kept], uv[kept], before.R_anchor)
        return replace(
            before,
            image=frame.image,
            uv=uv[kept],
            track_id=before.track_id[kept],
            anchor_uv=before.anchor_uv[kept],
            age=before.age + 1,
            R_image=np.eye(3),
        )

    def _predicted(self, camera: int, uv: Array, R_turn: Array) -> Array:
        """Where corners would be if the body had only turned, (k, 2) [px]."""
        R_IC = self.rig.R_IC[camera]
        rays = rays_of(self.lenses[camera], uv) @ (R_IC.T @ R_turn @ R_IC)
        ahead, ok = project_rays(self.lenses[camera], rays)
        return np.where(ok[:, None], ahead, uv)

    def _flow(
        self, a: GreyImage, b: GreyImage, uv: Array, guess: Array, levels: int
    ) -> tuple[Array, Mask]:
        if len(uv) == 0:
            return np.zeros((0, 2)), np.zeros(0, dtype=np.bool_)
        side = self.params.window_px
        moved, status, _ = cv2.calcOpticalFlowPyrLK(
            a,
            b,
            uv.astype(np.float32).reshape(-1, 1, 2),
            guess.astype(np.float32).reshape(-1, 1, 2).copy(),
            winSize=(side, side),
            maxLevel=levels,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.02),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(moved, dtype=np.float64).reshape(-1, 2), np.ravel(status) == 1

    def _epipolar(self, camera: int, before: Array, now: Array, R_turn: Array) -> Mask:
        """Which pairs agree with one motion of the camera; with few of them all do."""
        agree = np.ones(len(now), dtype=np.bool_)
        a, b = rays_of(self.lenses[camera], before), rays_of(self.lenses[camera], now)
        both = (a[:, 2] > LEAST_DEPTH) & (b[:, 2] > LEAST_DEPTH)
        if np.count_nonzero(both) < FEW:
            return agree
        threshold = self.params.epipolar_px / self.models[camera].focal_px[0]
        if self.params.motion == "gyro":
            R_IC = self.rig.R_IC[camera]
            turned = a[both] @ (R_IC.T @ R_turn @ R_IC)
            agree[both] = one_translation(turned, b[both], threshold)
        else:
            agree[both] = five_point(a[both], b[both], threshold)
        return agree if np.count_nonzero(agree) >= 0.5 * len(agree) else np.ones_like(agree)

    def _renewal_due(self, now: Followed) -> bool:
        p = self.params
        return now.age >= p.renew_frames or len(now.uv) < p.renew_share * now.anchored

    def _match(self, other: Followed | None, now: Followed, a: int, b: int) -> Followed:
        """Look for corners of camera a in camera b; those that both have must fit the rig."""
        if other is None or len(other.uv) == 0:
            return now
        R_ba = self.rig.R_IC[b].T @ self.rig.R_IC[a]
        p_ba = self.rig.R_IC[b].T @ (self.rig.p_IC[a] - self.rig.p_IC[b])
        threshold = self.params.epipolar_px / self.models[b].focal_px[0]
        _, i, j = np.intersect1d(other.track_id, now.track_id, return_indices=True)
        rays = rays_of(self.lenses[a], other.uv) @ R_ba.T
        seen = rays_of(self.lenses[b], now.uv[j])
        wrong = j[~matches_agree(rays[i], seen, p_ba, threshold)]
        now = _kept(now, ~np.isin(np.arange(len(now.uv)), wrong))
        fresh = ~np.isin(other.track_id, now.track_id)
        guess, ok = project_rays(self.lenses[b], rays)
        fresh &= ok & _inside(self.models[b], guess)
        uv, found = self._flow(other.image, now.image, other.uv[fresh], guess[fresh], 3)
        home, back = self._flow(now.image, other.image, uv, other.uv[fresh], 0)
        good = (
            found & back & (np.linalg.norm(home - other.uv[fresh], axis=1) <= self.params.back_px)
        )
        good &= _inside(self.models[b], uv)
        seen = rays_of(self.lenses[b], uv)
        good &= matches_agree(rays[fresh], seen, p_ba, threshold)
        apart = np.linalg.norm(uv[:, None] - now.uv[None], axis=2) if len(now.uv) else uv[:, :1]
        good &= np.min(apart, axis=1) > (0.5 * self.params.spacing_px if len(now.uv) else -np.inf)
        return _with(now, uv[good], other.track_id[fresh][good])

    def _fill(self, now: Followed, next_id: int) -> tuple[Followed, int]:
        """Make this image the anchor and add corners where there are none."""
        wanted = self.params.features // len(self.models) - len(now.uv)
        if wanted > 0:
            free = np.full(now.image.shape, 255, dtype=np.uint8)
            for u, v in np.round(now.uv).astype(int):
                cv2.circle(free, (int(u), int(v)), self.params.spacing_px, 0, -1)
            p = self.params
            threshold = p.quality if p.detector == "gftt" else p.fast_threshold
            fresh = find_corners(p.detector, now.image, free, wanted, p.spacing_px, threshold)
            ids = np.arange(next_id, next_id + len(fresh), dtype=np.int64)
            now, next_id = _with(now, fresh, ids), next_id + len(fresh)
        now = replace(
            now, anchor=now.image, anchor_uv=now.uv, anchored=len(now.uv), age=0,
            R_anchor=np.eye(3),
        )  # fmt: skip
        return now, next_id


def _turned(camera: Followed | None, R_turn: Array) -> Followed | None:
    """The same after the body has turned."""
    if camera is None:
        return None
    return replace(camera, R_anchor=camera.R_anchor @ R_turn, R_image=camera.R_image @ R_turn)


def _kept(now: Followed, good: Mask) -> Followed:
    return replace(now, uv=now.uv[good], track_id=now.track_id[good], anchor_uv=now.anchor_uv[good])


def _with(now: Followed, uv: Array, ids: IntArray) -> Followed:
    return replace(
        now,
        uv=np.vstack([now.uv, uv]),
        track_id=np.concatenate([now.track_id, ids]),
        anchor_uv=np.vstack([now.anchor_uv, uv]),
    )
