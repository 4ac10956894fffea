# SPDX-License-Identifier: Apache-2.0
"""A vehicle's cameras: when they fire, what decides their bytes, and whether they find the tag."""

import hashlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import cv2
import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.shapes import pose_shapes
from skyhaul.model.state import CableState, TeamState
from skyhaul.model.team import Team
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.sensors.camera import camera_pose, cameras
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.optics import LensParams
from skyhaul.sensors.rig import CameraMount, RigParams
from skyhaul.world.scenario import Light, LightChange, World

SMALL = LensParams(size_px=(64, 48), fov_deg=80.0)
RIG = RigParams(
    cameras=(
        CameraMount(name="a", lens=SMALL, p_BC_m=(0.05, 0.0, 0.0)),
        CameraMount(name="b", lens=SMALL, p_BC_m=(-0.05, 0.0, 0.0), azimuth_deg=180.0, rate_hz=5),
    )
)
LIGHT = Light(changes=(LightChange(at_s=0.35, level=0.1),))


def truth_at(t_us, yaw=0.7):
    """Four vehicles a metre above and around a load, all turned by `yaw`."""
    c, s = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    p = np.array([[0.6, 0.6, 2.0], [-0.6, 0.6, 2.0], [-0.6, -0.6, 2.0], [0.6, -0.6, 2.0]])
    q, zero, one = np.tile([c, 0.0, 0.0, s], (4, 1)), np.zeros((4, 3)), np.ones(4)
    load = (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    return Truth(
        t_us, TeamState(*load, p, q, zero, zero.copy()),
        CableState(zero.copy(), zero.copy(), one, one.copy()), one > 0, one > 0, np.ones((4, 4)),
        np.zeros((5, 3)), pose_shapes([], np.zeros((0, 3))), np.zeros((0, 3)),
        np.ones(0, bool), np.zeros(3), 1.0, (),
    )  # fmt: skip


def film(vehicle, scene=None, seed=3, until_us=400_000):
    """Stamps, cameras and images of one vehicle."""
    scene = scene or build_scene(Team(), World())
    rig = cameras(RIG, scene, LIGHT, vehicle, 4)
    memory, frames = rig.init(seed), []
    for t_us in range(0, until_us, PLANT_STEP_US):
        memory, new = rig.step(memory, truth_at(t_us))
        frames += new
    return frames


def digest(vehicle):
    """What a worker process makes of one vehicle."""
    return [(f.stamp_us, f.camera, hashlib.sha256(f.image).hexdigest()) for f in film(vehicle)]


@pytest.fixture(scope="module")
def hall():
    return build_scene(Team(), World())


def test_cameras_fire_at_their_rates_together_and_vehicles_take_turns(hall):
    for vehicle in range(4):
        frames = film(vehicle, hall)
        stamps = {c: [f.stamp_us for f in frames if f.camera == c] for c in (0, 1)}
        first = vehicle * 25_000 // PLANT_STEP_US * PLANT_STEP_US
        assert stamps[0] == list(range(first, 400_000, 100_000))
        assert stamps[1] == list(range(first, 400_000, 200_000))
        assert all(f.image.shape == (48, 64) for f in frames)


def test_images_are_the_same_in_two_worker_processes_and_in_any_order(hall):
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        apart = list(pool.map(digest, [0, 1]))
    together = []
    for vehicle in (1, 0):  # the other way round, in one scene that both move
        together.insert(0, [
            (f.stamp_us, f.camera, hashlib.sha256(f.image).hexdigest()) for f in film(vehicle, hall)
        ])  # fmt: skip
    assert apart == together


def test_seed_camera_vehicle_and_time_each_have_their_own_noise(hall):
    """The same view twice differs by noise alone, and by about as much as two noises."""
    one, other = film(0, hall), film(0, hall, seed=4)
    assert np.array_equal(one[0].image, film(0, hall)[0].image)
    twins = RigParams(cameras=(RIG.cameras[0], replace(RIG.cameras[0], name="b")))
    place = truth_at(0).team.p_WB
    images = []  # of two cameras in one place, first on vehicle 0, then on vehicle 1
    for vehicle in (0, 1):
        rig = cameras(twins, hall, LIGHT, vehicle, 4)
        truth = truth_at(rig.lag_us)
        where = place[[1, 0, 2, 3]] if vehicle else place
        truth = replace(truth, team=replace(truth.team, p_WB=where))
        images += rig.step(rig.init(3), truth)[1]
    pairs = [(one[0], other[0]), (one[0], one[2])]
    pairs += [(images[0], images[1]), (images[0], images[2]), (images[1], images[3])]
    for a, b in pairs:
        difference = a.image.astype(float) - b.image
        assert 0.5 < difference.std() < 8.0


def test_fading_light_darkens_the_next_image_and_exposure_follows(hall):
    means = [f.image.mean() for f in film(0, hall, until_us=3_000_000) if f.camera == 0]
    assert means[4] < 0.25 * means[3]
    assert means[-1] > 0.8 * means[3]
    rig = cameras(RIG, hall, Light(level=0.0), 0, 4)
    _, frames = rig.step(rig.init(0), truth_at(0))
    assert frames[0].image.max() < 5


def test_the_down_camera_finds_the_tag_and_where_it_is(hall):
    """Load 1.15 m away, behind and below to either side: within 3 cm and 3 deg."""
    rig = RigParams()
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_25h9)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)
    half = 0.5 * hall.tag.edge_m
    corners_L = np.array(
        [[-half, half, 0.0], [half, half, 0.0], [half, -half, 0.0], [-half, -half, 0.0]]
    )
    down = rig.cameras[3]
    (fx, fy), (cx, cy) = down.model.focal_px, down.model.center_px
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    for vehicle, cable in enumerate(np.radians([45, 135, 225, 315])):
        for off in np.radians([-40, 0, 40]):
            team = cameras(rig, hall, Light(), vehicle, 4)
            truth = truth_at(team.lag_us, cable + off)
            near = np.array(truth.team.p_WB)
            near[:, :2] *= 0.75
            object.__setattr__(truth.team, "p_WB", near)
            _, frames = team.step(team.init(0), truth)
            corners, ids, _ = detector.detectMarkers(frames[3].image)
            assert ids is not None
            assert ids.ravel().tolist() == [0]
            _, turn, p_CT = cv2.solvePnP(
                corners_L, corners[0].reshape(4, 2).astype(float), K,
                np.array(down.model.distortion), flags=cv2.SOLVEPNP_IPPE_SQUARE,
            )  # fmt: skip
            p_WC, R_WC = camera_pose(team.calibrations[3], truth, vehicle)
            plate = truth.team.p_WL + np.array([0.0, 0.0, 0.04])
            assert np.linalg.norm(p_CT.ravel() - R_WC.T @ (plate - p_WC)) < 0.03
            R_CT, R_WL = cv2.Rodrigues(turn)[0], quat_to_R(truth.team.q_WL)
            angle = np.arccos(np.clip((np.trace(R_CT.T @ R_WC.T @ R_WL) - 1.0) / 2.0, -1.0, 1.0))
            assert np.degrees(angle) < 3.0
