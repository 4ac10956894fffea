# SPDX-License-Identifier: Apache-2.0
"""Claim: the down cameras find the load's tag in >= 95 % of frames, to 3 cm and 3 degrees.

Every down camera of a flight of `paper`, seed 0, from lift-off to the end, five images a second
with noise and exposure. Found: `cv2.aruco` detects exactly the one tag (corners refined to
subpixels); pose: `cv2.SOLVEPNP_IPPE_SQUARE` with the lens's distortion, against truth.
"""

import cv2
import numpy as np
from calibration import calibration_s
from image_report import publish
from recorded_truth import flight, truths
from result_file import Row

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import CameraCalibration, GreyImage, TagCalibration
from skyhaul.sensors.camera import camera_pose, cameras
from skyhaul.sensors.imaging.photometry import expose
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.rig import RigParams
from skyhaul.types import US_PER_S, Array

DOWN = 3
"""Index of the down camera in the default rig."""


def detector() -> cv2.aruco.ArucoDetector:
    """The detector with subpixel corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_25h9)
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def tag_corners_L(tag: TagCalibration) -> Array:
    """Corners of the tag in load axes, in the detector's order, (4, 3) [m]."""
    h = 0.5 * tag.edge_m
    return tag.p_LT + np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]]) @ tag.R_LT.T


def pose_error(
    camera: CameraCalibration, corners: Array, corners_L: Array, truth: Truth, vehicle: int
) -> tuple[float, float]:
    """Errors of the tag's place [m] and attitude [deg] in camera axes."""
    (fx, fy), (cx, cy) = camera.model.focal_px, camera.model.center_px
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    centre = corners_L.mean(axis=0)
    _, turn, p_CT = cv2.solvePnP(
        corners_L - centre, corners, K, np.array(camera.model.distortion),
        flags=cv2.SOLVEPNP_IPPE_SQUARE,
    )  # fmt: skip
    p_WC, R_WC = camera_pose(camera, truth, vehicle)
    R_WL = quat_to_R(truth.team.q_WL)
    place = R_WC.T @ (truth.team.p_WL + R_WL @ centre - p_WC)
    cosine = 0.5 * (np.trace(cv2.Rodrigues(turn)[0].T @ R_WC.T @ R_WL) - 1.0)
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return float(np.linalg.norm(p_CT.ravel() - place)), float(angle)


def main() -> None:
    """Look at every down image of the flight."""
    run, args = flight(__doc__)
    truth_at, scenario = truths(run), run.scenario
    scene, rig = build_scene(scenario.team, scenario.world), RigParams()
    assert scene.tag is not None, "the load of `paper` carries one"
    tag, corners_L = scene.tag.id, tag_corners_L(scene.tag)
    teams = [cameras(rig, scene, scenario.world.light, i, 4) for i in range(scenario.team.count)]
    find, calibration = detector(), [calibration_s()]
    rows_after = np.flatnonzero(run.airborne)[:: 400 if args.quick else 20]
    frames = found = false = 0
    errors: list[tuple[float, float]] = []
    for k in rows_after.tolist():
        truth = truth_at(k)
        scene.pose(truth)
        for i, team in enumerate(teams):
            view = team.look(DOWN, truth)
            image: GreyImage = np.empty(view.grey.shape, dtype=np.uint8)
            level = scenario.world.light.at(truth.stamp_us / US_PER_S)
            expose(view.grey, team.sensors[DOWN], level, 1.0, 8 * k + i, image)
            corners, ids, _ = find.detectMarkers(image)
            names = [] if ids is None else ids.ravel().tolist()
            frames, false = frames + 1, false + len([n for n in names if n != tag])
            if names.count(tag) == 1:
                found += 1
                pixels = corners[names.index(tag)].reshape(4, 2).astype(np.float64)
                camera = team.calibrations[DOWN]
                errors.append(pose_error(camera, pixels, corners_L, truth, i))
    e = np.array(errors).reshape(-1, 2)
    good = np.mean((e[:, 0] <= 0.03) & (e[:, 1] <= 3.0)) * found / frames
    calibration.append(calibration_s())
    rows = [
        Row("tag found, of all down frames after lift-off", found / frames, "", ">= 0.95"),
        Row(
            "tag on the load found, within 3 cm and 3 deg, of all down frames",
            float(good),
            "",
            ">= 0.95",
        ),
        Row("place, median", float(np.median(e[:, 0])), "m"),
        Row("place, 95 %", float(np.quantile(e[:, 0], 0.95)), "m", "<= 0.03"),
        Row("place, largest", float(e[:, 0].max()), "m"),
        Row("attitude, median", float(np.median(e[:, 1])), "deg"),
        Row("attitude, 95 %", float(np.quantile(e[:, 1], 0.95)), "deg", "<= 3"),
        Row("attitude, largest", float(e[:, 1].max()), "deg"),
        Row("other tags found where none is", false, "", "0"),
    ]
    notes = {"frames": frames, "seeds": [run.origin.seed]}
    claim = "the tag is found in >= 95 % of down frames, its pose within 3 cm and 3 deg"
    publish("tag", claim, rows, notes, calibration, write=not args.quick)


if __name__ == "__main__":
    main()
