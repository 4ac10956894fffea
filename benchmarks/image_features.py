# SPDX-License-Identifier: Apache-2.0
"""Claim: every camera sees >= 100 well-spread corners in >= 95 % of the frames of a flight.

Every camera of every vehicle above 0.5 m in a flight of `paper`, seed 0, twice a second, noise and
exposure included. Corners: `cv2.goodFeaturesToTrack`, at most 400, quality 0.01, 6 px apart, block
of 5. Well spread: corners lie in at least half of 8 x 6 buckets of 40 x 40 px, and of each bucket
no more than 10 count towards the 100.
"""

import cv2
import numpy as np
from calibration import calibration_s
from image_report import publish
from recorded_truth import flight, truths
from result_file import Row

from skyhaul.sensors.api import GreyImage
from skyhaul.sensors.camera import cameras
from skyhaul.sensors.imaging.photometry import expose
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.rig import RigParams
from skyhaul.types import US_PER_S, IntArray

ACROSS, DOWN, MOST = 8, 6, 10


def buckets(image: GreyImage) -> IntArray:
    """Corners in each bucket, (DOWN, ACROSS)."""
    corners = cv2.goodFeaturesToTrack(image, 400, 0.01, 6.0, blockSize=5)
    counts = np.zeros((DOWN, ACROSS), dtype=np.int64)
    if corners is not None:
        h, w = image.shape
        x, y = corners.reshape(-1, 2).T
        np.add.at(counts, ((y * DOWN / h).astype(int), (x * ACROSS / w).astype(int)), 1)
    return counts


def main() -> None:
    """Look at the flight through every camera."""
    run, args = flight(__doc__)
    truth_at, scenario = truths(run, args.outward_deg), run.scenario
    scene, rig = build_scene(scenario.team, scenario.world), RigParams()
    teams = [cameras(rig, scene, scenario.world.light, i, 4) for i in range(scenario.team.count)]
    names, calibration = [m.name for m in rig.cameras], [calibration_s()]
    corners: dict[str, list[int]] = {name: [] for name in names}
    filled: dict[str, list[int]] = {name: [] for name in names}
    good: dict[str, list[bool]] = {name: [] for name in names}
    for k in range(0, len(run.t_s), 400 if args.quick else 50):
        truth = truth_at(k)
        scene.pose(truth)
        for i, team in enumerate(teams):
            if truth.team.p_WB[i, 2] <= 0.5:
                continue
            for c, name in enumerate(names):
                view = team.look(c, truth)
                image: GreyImage = np.empty(view.grey.shape, dtype=np.uint8)
                level = scenario.world.light.at(truth.stamp_us / US_PER_S)
                expose(view.grey, team.sensors[c], level, 1.0, 64 * k + 8 * i + c, image)
                counts = buckets(image)
                corners[name].append(int(counts.sum()))
                filled[name].append(int(np.sum(counts > 0)))
                spread = int(np.minimum(counts, MOST).sum())
                good[name].append(spread >= 100 and filled[name][-1] >= ACROSS * DOWN // 2)
    calibration.append(calibration_s())
    rows = [
        Row(f"{name}: frames with >= 100 well-spread corners", float(np.mean(good[name])), "",
            ">= 0.95")
        for name in names
    ]  # fmt: skip
    notes = {
        "frames_of_each_camera": len(good[names[0]]),
        "corners": {n: _spread(corners[n]) for n in names},
        "buckets_filled_of_48": {n: _spread(filled[n]) for n in names},
        "outward_deg": args.outward_deg,
        "seeds": [run.origin.seed],
    }
    print(notes)
    name = "image_features"
    if args.outward_deg is not None:
        name += f"_outward_{args.outward_deg:+.0f}"
    claim = "each camera sees >= 100 well-spread corners in >= 95 % of the frames above 0.5 m"
    publish(name, claim, rows, notes, calibration, write=not args.quick)


def _spread(values: list[int]) -> dict[str, float]:
    """Smallest, 5 % and median."""
    return {
        "min": float(np.min(values)),
        "5 %": float(np.quantile(values, 0.05)),
        "median": float(np.median(values)),
    }


if __name__ == "__main__":
    main()
