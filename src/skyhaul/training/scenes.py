# SPDX-License-Identifier: Apache-2.0
"""Randomised scenes: the event camera of a vehicle in flight, clutter that stands, things that fly.

Drawn anew for each scene: flight, vehicle and moment, textures, light, the pixels' thresholds and
noise, the lens, what stands near the vehicle's path, and what flies through its view. What flies
is not in the way of the team: the flight is as it was flown without it.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skyhaul.geometry.camera import CameraModel, Equidistant, RadTan
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.geometry.shapes import Box, Capsule, Shape, Sphere
from skyhaul.perception.events.noise_filter import KEPT, NoiseFilter, chosen
from skyhaul.perception.events.rotation import TurnMemory, turn_at
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.sensors.api import CameraCalibration, EventReading
from skyhaul.sensors.camera import camera_pose
from skyhaul.sensors.events.camera import EventCamera, EventParams, camera_motion, event_camera
from skyhaul.sensors.events.pixels import EventPixels
from skyhaul.sensors.imaging.scene import Scene, build_scene
from skyhaul.sensors.imu import imu_bank
from skyhaul.sensors.optics import LensParams
from skyhaul.sensors.rig import EventCameraMount
from skyhaul.sensors.suite import motion_of
from skyhaul.sensors.truth_track import TruthTrack
from skyhaul.training.flights import Flight
from skyhaul.types import US_PER_S, Array, IntArray, Vec3
from skyhaul.whole import whole
from skyhaul.world.motion import MovingObstacles, obstacle_field
from skyhaul.world.obstacles import Circle, Line, Motion, Obstacle
from skyhaul.world.scenario import Light, LightChange, World

STANDS, MOVES, TEAM = 0, 1, -1
"""Labels of events. The team's own vehicles, load and cables are neither: it knows where they
are."""

IMU_BODY = 1


@dataclass(frozen=True, kw_only=True)
class SceneRecipe:
    """What scenes are drawn from."""

    duration_s: float = 1.5
    """Length [s]."""
    movers: tuple[int, int] = (0, 6)
    """Least and most things that fly."""
    clutter: tuple[int, int] = (0, 14)
    """Least and most things that stand near."""
    size_m: tuple[float, float] = (0.1, 0.5)
    """Diameter of what flies [m]."""
    speed_mps: tuple[float, float] = (0.5, 4.0)
    """Speed of what flies [m/s]."""
    distance_m: tuple[float, float] = (0.8, 6.0)
    """Distance from the camera at some moment of the scene [m]."""
    narrow_share: float = 0.2
    """Share of scenes with another lens than the rig's, of 50 to 90 degrees."""
    still_share: float = 0.06
    """Share of scenes in which the vehicle stands still in the air."""
    most_events: int = 250_000
    """A scene ends with so many."""
    velocity_error_mps: float = 0.04
    """Standard deviation of the error of the camera's known velocity, each axis [m/s]."""


@dataclass(frozen=True, eq=False)
class LabelledStream:
    """Events of a scene that passed the noise filter, and what caused each."""

    model: CameraModel
    events: EventReading
    turn_C: Array  # (k, 3) integral of the gyro [rad]
    v_WC_C: Array  # (k, 3) velocity of the camera as its vehicle knows it [m/s]
    label: IntArray  # (k,) STANDS, MOVES or TEAM
    object_id: IntArray  # (k,) of the scene, negative for noise

    def part(self, a: int, b: int) -> "LabelledStream":
        """Events a to b."""
        e, cut = self.events, slice(a, b)
        return LabelledStream(
            self.model, EventReading(e.t_us[cut], e.x[cut], e.y[cut], e.p[cut]),
            self.turn_C[cut], self.v_WC_C[cut], self.label[cut], self.object_id[cut],
        )  # fmt: skip


def scene_stream(flight: Flight, recipe: SceneRecipe, seed: int) -> LabelledStream:
    """Draw a scene and look at it; the same seed gives the same bytes."""
    rng = np.random.default_rng([seed, 11])
    rows = flight.airborne()
    steps = round(recipe.duration_s * US_PER_S / PLANT_STEP_US)
    begin = int(rng.choice(rows[: max(1, len(rows) - steps)]))
    vehicle = int(rng.integers(flight.config.team.count))
    mount = _mount(rng, recipe)
    world = _world(flight, recipe, rng, begin, steps, vehicle, mount)
    field = obstacle_field(world, 0)
    scene = build_scene(flight.config.team, world, int(rng.integers(2**31)))
    params = EventParams(pixels=_pixels(rng))
    camera = event_camera(params, mount, scene, world.light, vehicle)
    return _look(flight, camera, field, scene, rng, (begin, begin + steps), seed, recipe)


def _look(
    flight: Flight, camera: EventCamera, field: MovingObstacles, scene: Scene,
    rng: np.random.Generator, rows: tuple[int, int], seed: int, recipe: SceneRecipe,
) -> LabelledStream:  # fmt: skip
    """Events, labels, gyro and velocity over some rows of a flight."""
    config, vehicle = flight.config, camera.vehicle
    bank = imu_bank([config.sensors.imu], [IMU_BODY + vehicle])
    imu, memory = bank.init(seed), camera.init(seed)
    R_BI, R_BC = config.sensors.imu.calibration().R_BI, camera.calibration.R_BC
    parts, labels, stamps, gyro, velocity, times = [], [], [], [], [], []
    count = 0
    present = np.ones(len(field.names), np.bool_)
    still = rng.random() < recipe.still_share
    for k in range(*rows):
        truth = _stopped(flight.track, rows[0], k) if still else flight.track.truth(k)
        truth = replace(
            truth, obstacles=field.shapes_at(truth.stamp_us),
            v_WO=field.velocities_at(truth.stamp_us), present=present,
        )  # fmt: skip
        imu, (samples,) = bank.step(imu, truth.stamp_us, motion_of(truth))
        stamps.append(samples.stamp_us)
        gyro.append(samples.gyro_I @ R_BI.T @ R_BC)
        R_WB = quat_to_R(truth.team.q_WB[vehicle])
        velocity.append(camera_motion(camera.calibration, truth, vehicle)[0] @ R_WB @ R_BC)
        times.append(truth.stamp_us)
        memory, reading, label = camera.step(memory, truth)
        if reading is not None and label is not None:
            parts.append(reading)
            labels.append(label.object_id.astype(np.int64))
            count += len(reading.t_us)
        if count > recipe.most_events:
            break
    events = EventReading(*(np.concatenate([getattr(p, n) for p in parts])
                            for n in ("t_us", "x", "y", "p")))  # fmt: skip
    w, h = camera.calibration.model.size_px
    noise = NoiseFilter()
    _, why = noise.step(noise.init(w, h), events)
    events, owner = chosen(events, why == KEPT), np.concatenate(labels)[why == KEPT]
    _, turn_C = turn_at(TurnMemory(), np.concatenate(stamps), np.concatenate(gyro), events.t_us)
    known = np.array(velocity) + rng.normal(0.0, recipe.velocity_error_mps, 3)
    v_C = np.column_stack([np.interp(events.t_us, times, known[:, c]) for c in range(3)])
    return LabelledStream(
        camera.calibration.model, events, turn_C, v_C, _meaning(scene)[owner], owner
    )


def _stopped(track: TruthTrack, row: int, now: int) -> Truth:
    """Truth of one row at the time of another, with nothing that moves."""
    truth = track.truth(row)
    zeros = {name: np.zeros_like(getattr(truth.team, name))
             for name in ("v_WL", "w_WL_L", "v_WB", "w_WB_B")}  # fmt: skip
    return replace(truth, stamp_us=int(track.t_us[now]), team=replace(truth.team, **zeros))


def _meaning(scene: Scene) -> IntArray:
    """Label of each object id; the last two rows are those of sky and noise."""
    of = {"mover": MOVES, "room": STANDS, "static": STANDS}
    return np.array([*(of.get(kind, TEAM) for kind in scene.kinds), STANDS, STANDS])


def _mount(rng: np.random.Generator, recipe: SceneRecipe) -> EventCameraMount:
    mount = EventCameraMount()
    if rng.random() < recipe.narrow_share:
        fov = float(rng.uniform(50.0, 90.0))
        return replace(mount, lens=LensParams(size_px=(160, 120), fov_deg=fov))
    return mount


def _pixels(rng: np.random.Generator) -> EventPixels:
    return EventPixels(
        threshold_on=float(rng.uniform(0.16, 0.3)),
        threshold_off=float(rng.uniform(0.14, 0.26)),
        shot_hz=float(rng.uniform(0.05, 0.6)),
        cutoff_hz=float(rng.uniform(150.0, 500.0)),
    )


def _light(rng: np.random.Generator, begin_s: float, duration_s: float) -> Light:
    level = float(np.exp(rng.uniform(np.log(0.15), np.log(1.3))))
    changes: tuple[LightChange, ...] = ()
    if rng.random() < 0.15:
        at = begin_s + float(rng.uniform(0.2, 0.8)) * duration_s
        factor = float(np.exp(rng.uniform(-1.0, 1.0)))
        changes = (LightChange(at_s=at, level=level * factor, ramp_s=float(rng.uniform(0.2, 1.0))),)
    return Light(level=level, changes=changes)


def _world(
    flight: Flight, recipe: SceneRecipe, rng: np.random.Generator,
    begin: int, steps: int, vehicle: int, mount: EventCameraMount,
) -> World:  # fmt: skip
    """The flight's world with other light, clutter and movers."""
    world, track = flight.config.world, flight.track
    begin_s = track.t_us[begin] / US_PER_S
    path = track.p_WB[begin : begin + steps : 50].reshape(-1, 3)
    path = np.concatenate([path, track.p_WL[begin : begin + steps : 50]])
    calibration = mount.calibration()
    obstacles = list(world.obstacles)
    for j in range(int(rng.integers(recipe.clutter[0], recipe.clutter[1] + 1))):
        row = begin + int(rng.integers(steps))
        p = _place(flight, rng, row, vehicle, calibration, (0.9, 7.0))
        shape, reach = _shape(rng, float(np.exp(rng.uniform(np.log(0.1), np.log(1.2)))))
        if np.min(np.linalg.norm(path - p, axis=1)) > reach + 0.35:
            obstacles.append(Obstacle(name=f"stands {j}", shape=shape, center_m=_vec(p)))
    for j in range(int(rng.integers(recipe.movers[0], recipe.movers[1] + 1))):
        row = begin + int(rng.integers(steps))
        p = _place(flight, rng, row, vehicle, calibration, recipe.distance_m)
        low, high = np.log(recipe.size_m)
        shape, _ = _shape(rng, float(np.exp(rng.uniform(low, high))))
        center, motion = _motion(rng, recipe, p, track.t_us[row] / US_PER_S)
        obstacles.append(Obstacle(name=f"flies {j}", shape=shape, center_m=center, motion=motion))
    light = _light(rng, begin_s, recipe.duration_s)
    return replace(world, obstacles=tuple(obstacles), light=light)


def _place(
    flight: Flight, rng: np.random.Generator, row: int, vehicle: int,
    camera: CameraCalibration, distance_m: tuple[float, float],
) -> Array:  # fmt: skip
    """A point inside the room and the view of a vehicle's camera at a row of a flight."""
    room = flight.config.world.room
    low, high = np.array(room.min_m) + 0.3, np.array(room.max_m) - 0.3
    p_WC, R_WC = camera_pose(camera, flight.track.truth(row), vehicle)
    spread = 1.0 if isinstance(camera.model, Equidistant) else 0.5
    for _ in range(50):
        xy = rng.uniform(-spread, spread, 2) * [1.1, 0.8]
        angle = float(np.hypot(*xy))
        ray = np.array([*(xy * np.sinc(angle / np.pi)), np.cos(angle)])
        d = float(np.exp(rng.uniform(*np.log(distance_m))))
        p: Array = p_WC + d * (R_WC @ ray)
        if np.all((p > low) & (p < high)):
            return p
    return np.clip(p, low, high)


def _shape(rng: np.random.Generator, size_m: float) -> tuple[Shape, float]:
    """A form of about this diameter, and how far it reaches [m]."""
    kind = rng.integers(3)
    if kind == 0:
        return Sphere(radius_m=0.5 * size_m), 0.5 * size_m
    if kind == 1:
        edges = size_m * rng.uniform(0.5, 1.0, 3)
        return Box(size_m=_vec(edges), yaw_deg=float(rng.uniform(0, 90))), 0.9 * size_m
    length = float(size_m * rng.uniform(0.5, 2.0))
    axis = rng.normal(size=3)
    return Capsule(radius_m=0.25 * size_m, length_m=length, axis=_vec(axis)), size_m + length


def _motion(
    rng: np.random.Generator, recipe: SceneRecipe, p: Array, at_s: float
) -> tuple[Vec3, Motion]:
    """Own place and motion of something that is at p at a time."""
    low, high = np.log(recipe.speed_mps)
    speed = float(np.exp(rng.uniform(low, high)))
    way = rng.normal(size=3) * [1.0, 1.0, 0.6]
    way /= np.linalg.norm(way)
    if rng.random() < 0.7:
        return _vec(p - at_s * speed * way), Line(velocity_mps=_vec(speed * way))
    arm = rng.normal(size=3)
    arm -= way * (arm @ way)
    arm *= float(rng.uniform(0.3, 1.5)) / np.linalg.norm(arm)
    period = 2.0 * np.pi * float(np.linalg.norm(arm)) / speed
    circle = Circle(
        center_m=_vec(p + arm), period_s=period, normal=_vec(np.cross(arm, way)),
        phase_s=float(-at_s % period),
    )  # fmt: skip
    return _vec(p), circle


def _vec(v: Array) -> Vec3:
    return float(v[0]), float(v[1]), float(v[2])


def save_stream(stream: LabelledStream, path: Path) -> None:
    """Write a stream; a reader finds all of it or nothing."""
    e, model = stream.events, stream.model
    with whole(path) as part, part.open("wb") as file:
        np.savez(
            file, t_us=e.t_us, x=e.x, y=e.y, p=e.p, turn_C=stream.turn_C,
            v_WC_C=stream.v_WC_C, label=stream.label.astype(np.int8),
            object_id=stream.object_id.astype(np.int16),
            fisheye=isinstance(model, Equidistant), size_px=model.size_px,
            focal_px=model.focal_px, center_px=model.center_px, distortion=model.distortion,
        )  # fmt: skip


def load_stream(path: Path) -> LabelledStream:
    """Read a stream that `save_stream` wrote."""
    with np.load(path) as file:
        a = {name: file[name] for name in file.files}
    kind = Equidistant if a["fisheye"] else RadTan
    width, height = a["size_px"].tolist()
    model = kind(
        size_px=(width, height), focal_px=tuple(a["focal_px"].tolist()),
        center_px=tuple(a["center_px"].tolist()), distortion=tuple(a["distortion"].tolist()),
    )  # fmt: skip
    events = EventReading(a["t_us"], a["x"], a["y"], a["p"])
    return LabelledStream(
        model, events, a["turn_C"], a["v_WC_C"], a["label"].astype(np.int64),
        a["object_id"].astype(np.int64),
    )  # fmt: skip
