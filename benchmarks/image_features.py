# SPDX-License-Identifier: Apache-2.0
"""Claim: every camera sees >= 100 well-spread corners in >= 95 % of the frames of a flight.

Every camera of every vehicle above 0.5 m in a flight of `paper`, seed 0, twice a second, noise and
exposure included. Corners: `cv2.goodFeaturesToTrack`, at most 400, quality 0.01, 6 px apart, block
of 5. Well spread: corners lie in at least half of 8 x 6 buckets of 40 x 40 px, and of each bucket
no more than 10 count towards the 100.

That corners are places and not noise is told by tracking them into the image 0.1 s later
(`cv2.calcOpticalFlowPyrLK`, window 15, 4 levels): right is what ends within 1 px of where the
point really went, of those corners on things that stand whose point is still in sight.
"""

import cv2
import numpy as np
from calibration import calibration_s
from image_report import publish
from recorded_truth import flight, truths
from result_file import Row

from skyhaul.geometry.camera import project_points, unproject_pixels
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import GreyImage
from skyhaul.sensors.camera import Cameras, camera_pose, cameras
from skyhaul.sensors.imaging.photometry import expose
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.rig import RigParams
from skyhaul.types import US_PER_S, Array, IntArray

ACROSS, DOWN, MOST, LATER = 8, 6, 10, 10
"""Buckets, corners that count of each, and rows of the run between two images."""


def snap(team: Cameras, c: int, truth: Truth) -> GreyImage:
    """A noisy image of camera c in the posed scene, at exposure 1."""
    view = team.look(c, truth)
    image: GreyImage = np.empty(view.grey.shape, dtype=np.uint8)
    level = team.light.at(truth.stamp_us / US_PER_S)
    expose(view.grey, team.sensors[c], level, 1.0, truth.stamp_us + 8 * team.vehicle + c, image)
    return image


def corners_of(image: GreyImage) -> Array:
    """Corners, (k, 2) [px]."""
    found = cv2.goodFeaturesToTrack(image, 400, 0.01, 6.0, blockSize=5)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)


def buckets(corners: Array, image: GreyImage) -> IntArray:
    """Corners in each bucket, (DOWN, ACROSS)."""
    counts, (h, w) = np.zeros((DOWN, ACROSS), dtype=np.int64), image.shape
    x, y = corners.T
    np.add.at(counts, ((y * DOWN / h).astype(int), (x * ACROSS / w).astype(int)), 1)
    return counts


def tracked(
    team: Cameras, c: int, now: Truth, later: Truth, image: GreyImage, corners: Array
) -> float:
    """Share of the corners that are tracked right; the scene is posed at `now`, then `later`."""
    view, calibration = team.frames[c], team.calibrations[c]
    x, y = np.rint(corners).astype(int).T
    kinds = np.array([*team.scene.kinds, "sky"])[view.object_id[y, x]]
    stands = np.isin(kinds, ("room", "static")) & np.isfinite(view.range[y, x])
    rays = unproject_pixels(calibration.model, corners) * view.range[y, x][:, None]
    (p, R), (p_later, R_later) = (camera_pose(calibration, t, team.vehicle) for t in (now, later))
    points = p + rays[stands] @ R.T
    truth, ok = project_points(calibration.model, (points - p_later) @ R_later)
    team.scene.pose(later)
    after = snap(team, c, later)
    team.scene.pose(now)
    start = corners[stands].astype(np.float32)
    end, status, _ = cv2.calcOpticalFlowPyrLK(
        image, after, start, None, winSize=(15, 15), maxLevel=3
    )
    in_sight = ok & np.all((truth > 8.0) & (truth < np.array(image.shape[::-1]) - 9.0), axis=1)
    right = (status.ravel() == 1) & (np.linalg.norm(end - truth, axis=1) < 1.0)
    return float(np.mean(right[in_sight]))


def main() -> None:
    """Look at the flight through every camera."""
    run, args = flight(__doc__)
    truth_at, scenario = truths(run), run.scenario
    scene, rig = build_scene(scenario.team, scenario.world), RigParams()
    teams = [cameras(rig, scene, scenario.world.light, i, 4) for i in range(scenario.team.count)]
    names, calibration = [m.name for m in rig.cameras], [calibration_s()]
    count: dict[str, list[float]] = {name: [] for name in names}
    filled: dict[str, list[float]] = {name: [] for name in names}
    right: dict[str, list[float]] = {name: [] for name in names}
    good: dict[str, list[bool]] = {name: [] for name in names}
    for k in range(0, len(run.t_s) - LATER, 400 if args.quick else 50):
        truth, later = truth_at(k), truth_at(k + LATER)
        scene.pose(truth)
        for i, team in enumerate(teams):
            if truth.team.p_WB[i, 2] <= 0.5:
                continue
            for c, name in enumerate(names):
                image = snap(team, c, truth)
                corners = corners_of(image)
                counts = buckets(corners, image)
                count[name].append(len(corners))
                filled[name].append(float(np.sum(counts > 0)))
                spread = np.minimum(counts, MOST).sum()
                good[name].append(bool(spread >= 100 and filled[name][-1] >= ACROSS * DOWN // 2))
                right[name].append(tracked(team, c, truth, later, image, corners))
    calibration.append(calibration_s())
    rows = [
        Row(f"{name}: frames with >= 100 well-spread corners", float(np.mean(good[name])), "",
            ">= 0.95")
        for name in names
    ] + [
        Row(f"{name}: tracked right over 0.1 s, median", float(np.median(right[name])))
        for name in names
    ]  # fmt: skip
    notes = {
        "frames_of_each_camera": len(good[names[0]]),
        "corners": {n: _spread(count[n]) for n in names},
        "buckets_filled_of_48": {n: _spread(filled[n]) for n in names},
        "tracked_right": {n: _spread(right[n]) for n in names},
        "seeds": [run.origin.seed],
    }
    print(notes)
    claim = "each camera sees >= 100 well-spread corners in >= 95 % of the frames above 0.5 m"
    publish("image_features", claim, rows, notes, calibration, write=not args.quick)


def _spread(values: list[float]) -> dict[str, float]:
    """Smallest, 5 % and median."""
    return {
        "min": float(np.min(values)),
        "5 %": float(np.quantile(values, 0.05)),
        "median": float(np.median(values)),
    }


if __name__ == "__main__":
    main()
