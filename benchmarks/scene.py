# SPDX-License-Identifier: Apache-2.0
"""Claim: by their cameras alone the vehicles of `paper` map what stands and track what moves.

Flights of `paper` on truth, their cameras simulated (`vio_flight_data`), run through the estimator
of `perception.obstacles.kind=cameras` at the true poses: how well voxels lie on the boxes that
came near and in view, how well and how early movers are tracked, what is tracked that is not there,
how often the tubes hold, what it costs.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from calibration import calibration_s
from pool import run_all
from provenance import provenance, write_report
from result_file import Row
from vio_flight_data import FlightJob, fly_track, replay_of, seen_of

from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.mission.config import RunConfig
from skyhaul.perception.api import Track
from skyhaul.perception.obstacles.api import TeamViews, VehicleView
from skyhaul.perception.scene.from_cameras import CameraObstacles, TeamScene
from skyhaul.plant.api import Truth
from skyhaul.types import US_PER_S, Array, TimeUs
from skyhaul.world.scenario import Obstacle

POSE = np.diag([1e-4] * 3 + [1e-6] * 3)
"""Covariance of a vehicle's pose: 1 cm, 1 mrad."""
NEAR_M, CONFIRM_M, MINE_M = 3.0, 2.0, 0.6
"""Movers count within this of a vehicle; they should be confirmed before that; a track farther
from every mover than this is of nothing [m]."""


def surface_distance(obstacle: Obstacle, p_O: Array) -> Array:
    """Signed distance of points in the obstacle's axes to its surface, (..., 3) -> (...) [m]."""
    shape = obstacle.shape
    if shape.kind == "box":
        off = np.abs(p_O) - 0.5 * np.array(shape.size_m)
        outside = np.linalg.norm(np.maximum(off, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(off.max(axis=-1), 0.0))
    if shape.kind == "capsule":
        along = np.clip(p_O[..., 2], -0.5 * shape.length_m, 0.5 * shape.length_m)
        p_O = p_O - along[..., None] * np.array([0.0, 0.0, 1.0])
    return np.asarray(np.linalg.norm(p_O, axis=-1) - shape.radius_m)


def views_of(job: FlightJob, work: Path, vehicles: int) -> dict[TimeUs, list[VehicleView]]:
    """Images of all cameras of every vehicle, by time; pairs first, the others beside them."""
    found: dict[TimeUs, list[VehicleView]] = {}
    for i in range(vehicles):
        seen = seen_of(job, i, work)
        by_time: dict[TimeUs, dict[int, Any]] = {}
        for t, camera, image in zip(
            seen.stamp_us.tolist(), seen.camera.tolist(), seen.images, strict=True
        ):
            by_time.setdefault(t, {})[camera] = image
        for t, images in by_time.items():
            if {0, 1} <= set(images):
                others = tuple((k, images[k]) for k in sorted(images) if k > 1)
                found.setdefault(t, []).append(
                    VehicleView(i, t, images[0], images[1], POSE, others)
                )
    return dict(sorted(found.items()))


def estimator_of(config: RunConfig) -> TeamScene:
    """The estimator of a flight."""
    frame, room = config.world.map, config.world.room
    cells = np.ceil(np.array(frame.size_m) / frame.voxel_m - 1e-9).astype(np.int64)
    return CameraObstacles().build(
        config.team, config.sensors.calibration(), np.array([room.min_m, room.max_m], np.float64),
        np.array(frame.origin_m) + 0.5 * frame.voxel_m, frame.voxel_m, cells,
    )  # fmt: skip


@dataclass(eq=False)
class Found:
    """What a flight showed of its movers."""

    position: list[float] = field(default_factory=list)  # errors near the team [m]
    velocity: list[float] = field(default_factory=list)  # [m/s]
    held: list[bool] = field(default_factory=list)  # by the tube, one second later
    nothing_s: float = 0.0  # tracks of nothing, summed
    first_m: dict[int, float] = field(default_factory=dict)  # distance when confirmed, by mover
    names: dict[int, set[int]] = field(default_factory=dict)  # of the tracks of each mover


def run(job: tuple[int, Path]) -> dict[str, Any]:
    """Figures of one flight."""
    seed, work = job
    flight = FlightJob("paper", seed)
    fly_track(flight, work)
    config, replay = flight.config(), replay_of(flight, work)
    truths = list(replay.track.truths())
    scene, found, cpu_s, frames = estimator_of(config), Found(), 0.0, 0
    movers = [j for j, o in enumerate(config.world.obstacles) if o.motion.kind != "static"]
    memory = scene.init()
    views = views_of(flight, work, config.team.count)
    for t_us, seen in views.items():
        truth = truths[t_us // 2_000]
        reading = TeamViews(t_us, truth.team, truth.attached.copy(), tuple(seen))
        begin = time.process_time()
        memory, estimate = scene.step(memory, reading)
        cpu_s += time.process_time() - begin
        frames += len(seen)
        if memory.tracked_us == t_us:
            for track in estimate.tracks:
                _judge(found, track, truths, t_us, movers, scene.params.period_us)
    closest = {j: min(_reach(config, t, j) for t in truths[::25]) for j in movers}
    begun = {j: _reach(config, truths[0], j) for j in movers}
    due = [j for j in movers if closest[j] < NEAR_M and begun[j] > NEAR_M]
    occupied = scene.p_WO + scene.voxel_m * np.argwhere(memory.evidence.occupied)
    return {
        "seed": seed,
        "position_rmse_m": _rms(found.position),
        "velocity_rmse_mps": _rms(found.velocity),
        "tube_holds": float(np.mean(found.held)),
        "nothing_s_per_min": 60.0 * found.nothing_s / (1e-6 * truths[-1].stamp_us),
        "due": len(due),
        "confirmed_in_time": sum(found.first_m.get(j, 0.0) >= CONFIRM_M for j in due),
        "confirmed": sum(j in found.first_m for j in due),
        "names_per_mover": float(np.mean([len(n) for n in found.names.values()])),
        **_map_figures(config, truths, scene, occupied, memory.evidence.occupied, movers, views),
        "ms_per_vehicle_frame": 1e3 * cpu_s / frames,
        "cpu_s_per_s": cpu_s / (1e-6 * truths[-1].stamp_us),
        "calibration_s": calibration_s(),
    }


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _reach(config: RunConfig, truth: Truth, j: int) -> float:
    """From the nearest vehicle to the surface of an obstacle [m]."""
    o = truth.obstacles
    off = (truth.team.p_WB - o.p_WO[j]) @ o.R_WO[j]
    return float(surface_distance(config.world.obstacles[j], off).min())


def _judge(
    found: Found, track: Track, truths: list[Truth], t_us: TimeUs, movers: list[int],
    period_us: TimeUs,
) -> None:  # fmt: skip
    """Compare a track with the mover that is nearest."""
    truth = truths[t_us // 2_000]
    off = [float(np.linalg.norm(track.p_WO - truth.obstacles.p_WO[j])) for j in movers]
    j = movers[int(np.argmin(off))]
    if min(off) > MINE_M:
        found.nothing_s += 1e-6 * period_us
        return
    distance = float(np.linalg.norm(truth.team.p_WB - truth.obstacles.p_WO[j], axis=1).min())
    found.first_m.setdefault(j, distance)
    found.names.setdefault(j, set()).add(track.track_id)
    if distance < NEAR_M:
        found.position.append(min(off))
        found.velocity.append(float(np.linalg.norm(track.v_WO - truth.v_WO[j])))
    later = (t_us + US_PER_S) // 2_000
    if later < len(truths):
        predicted = track.p_WO + track.v_WO
        miss = float(np.linalg.norm(truths[later].obstacles.p_WO[j] - predicted))
        found.held.append(miss <= track.tube_m(1.0))


def _map_figures(
    config: RunConfig, truths: list[Truth], scene: TeamScene, occupied: Array, grid: Any,  # noqa: ANN401
    movers: list[int], views: dict[TimeUs, list[VehicleView]],
) -> dict[str, Any]:  # fmt: skip
    """Precision to one voxel, and recall of the box voxels that came within 3 m and in view."""
    last, near = truths[-1].obstacles, np.full(len(occupied), np.inf)
    right, wanted, offs = 0, 0, []
    for j, obstacle in enumerate(config.world.obstacles):
        if j in movers or obstacle.shape.kind != "box":
            continue
        p_O = (occupied - last.p_WO[j]) @ last.R_WO[j]
        near = np.minimum(near, surface_distance(obstacle, p_O))
        for face, cells in _faces(np.array(obstacle.shape.size_m), scene.voxel_m):
            points = last.p_WO[j] + cells @ last.R_WO[j].T
            normal = last.R_WO[j] @ face
            visible = _was_visible(scene, truths, views, points, normal)
            wanted += int(visible.sum())
            index = np.floor((points[visible] - scene.p_WO) / scene.voxel_m + 0.5).astype(int)
            right += int(_neighbourhood(grid, index).sum())
            offs += _face_off(p_O, face, np.array(obstacle.shape.size_m), int(visible.sum()))
    return {
        "voxels": len(occupied),
        "precision": float(np.mean(near <= scene.voxel_m)) if len(occupied) else float("nan"),
        "recall": right / wanted if wanted else float("nan"),
        "face_off_m": float(np.max(offs)) if offs else float("nan"),
    }


def _faces(size: Array, voxel: float) -> Iterator[tuple[Array, Array]]:
    """Outward normal and points, a voxel apart, of each face of a box, in its axes."""
    for axis in range(3):
        a, b = [k for k in range(3) if k != axis]
        u = np.arange(-0.5 * size[a] + 0.5 * voxel, 0.5 * size[a], voxel)
        v = np.arange(-0.5 * size[b] + 0.5 * voxel, 0.5 * size[b], voxel)
        for sign in (-1.0, 1.0):
            cells = np.zeros((len(u), len(v), 3))
            cells[..., a], cells[..., b] = u[:, None], v[None, :]
            cells[..., axis] = sign * (0.5 * size[axis] - 0.25 * voxel)
            normal = np.zeros(3)
            normal[axis] = sign
            yield normal, cells.reshape(-1, 3)


def _was_visible(
    scene: TeamScene, truths: list[Truth], views: dict[TimeUs, list[VehicleView]], points: Array,
    normal: Array,
) -> Array:  # fmt: skip
    """Points of a face that a pair saw within 3 m, not slanted by more than 75 deg, 4 times."""
    pair = scene.watches[0].pair
    height, width = pair.valid.shape
    times = np.zeros(len(points), int)
    for t_us, seen in views.items():
        team = truths[t_us // 2_000].team
        for view in seen:
            R_WB = quat_to_R(team.q_WB[view.vehicle])
            R_WC = R_WB @ pair.left.R_BC
            rel = points - team.p_WB[view.vehicle] - R_WB @ pair.left.p_BC
            far = np.linalg.norm(rel, axis=1)
            p_C = rel @ R_WC
            with np.errstate(divide="ignore", invalid="ignore"):
                u = pair.params.focal_px * p_C[:, 0] / p_C[:, 2] + 0.5 * (width - 1)
                v = pair.params.focal_px * p_C[:, 1] / p_C[:, 2] + 0.5 * (height - 1)
            inside = (p_C[:, 2] > 0.3) & (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
            facing = -(rel @ normal) > np.cos(np.radians(75.0)) * far
            ok = inside & facing & (far < NEAR_M)
            ok[ok] = pair.valid[np.rint(v[ok]).astype(int), np.rint(u[ok]).astype(int)]
            times += ok
    return times >= 4


def _neighbourhood(grid: Any, index: Array) -> Array:  # noqa: ANN401
    """Whether a voxel or one that shares a face with it is occupied, (k,)."""
    out = np.zeros(len(index), bool)
    for step in np.vstack([np.zeros(3, int), np.eye(3, dtype=int), -np.eye(3, dtype=int)]):
        i, j, k = (index + step).T
        out |= grid[i, j, k]
    return out


def _face_off(p_O: Array, face: Array, size: Array, seen: int) -> list[float]:
    """How far the median voxel of a face that was seen lies off it [m]."""
    axis = int(np.argmax(np.abs(face)))
    along = p_O @ face - 0.5 * size[axis]
    beside = np.delete(np.abs(p_O) <= 0.5 * size - 0.05, axis, axis=1).all(axis=1)
    mine = beside & (np.abs(along) < 0.3)
    return [abs(float(np.median(along[mine])))] if seen >= 4 and mine.sum() >= 4 else []


def rows(runs: list[dict[str, Any]]) -> list[Row]:
    """The lines of the table."""
    of = lambda key: [r[key] for r in runs]  # noqa: E731
    due = sum(of("due"))
    in_time = f"{sum(of('confirmed_in_time'))}/{due}"
    return [
        Row("`paper` by cameras: flights", len(runs)),
        Row("movers: position RMSE within 3 m, mean", float(np.mean(of("position_rmse_m"))), "m"),
        Row("movers: the same, worst flight", max(of("position_rmse_m")), "m", "<= 0.25"),
        Row("movers: velocity RMSE, mean", float(np.mean(of("velocity_rmse_mps"))), "m/s"),
        Row("movers: the same, worst flight", max(of("velocity_rmse_mps")), "m/s", "<= 0.3"),
        Row(
            "movers that came within 3 m: confirmed before 2 m", in_time, "", "all",
        ),
        Row("movers that came within 3 m: confirmed at all", f"{sum(of('confirmed'))}/{due}"),
        Row("tracks of nothing", float(np.mean(of("nothing_s_per_min"))), "s a minute"),
        Row("tubes hold after 1 s", 100.0 * float(np.mean(of("tube_holds"))), "%", "90 .. 99"),
        Row("names of a mover, mean", float(np.mean(of("names_per_mover"))), "", "1"),
        Row("map: precision to one voxel, worst flight", min(of("precision")), "", ">= 0.95"),
        Row("map: precision, mean", float(np.mean(of("precision"))), ""),
        Row("map: recall, worst flight", min(of("recall")), "", ">= 0.9"),
        Row("map: recall, mean", float(np.mean(of("recall")))),
        Row("map: face of a box off by, worst", 100.0 * max(of("face_off_m")), "cm", "<= 10"),
        Row("a vehicle's frame", float(np.median(of("ms_per_vehicle_frame"))), "ms CPU"),
        Row("the team", float(np.median(of("cpu_s_per_s"))), "CPU-s per simulated second"),
    ]  # fmt: skip


def main() -> None:
    """Run the flights and write `results/scene.json`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="flights (default: 10)")
    parser.add_argument("--work", type=Path, default=Path("build/vio_flights"))
    parser.add_argument("--workers", type=int, default=1, help="processes (default: 1)")
    parser.add_argument("--quick", action="store_true", help="one flight; writes nothing")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    jobs = [(seed, args.work) for seed in range(1 if args.quick else args.seeds)]
    runs = []
    for _, figures in run_all(run, jobs, args.workers):
        print({k: round(v, 4) if isinstance(v, float) else v for k, v in figures.items()})
        runs.append(figures)
    runs.sort(key=lambda r: r["seed"])
    table = rows(runs)
    for row in table:
        print(f"{row.measure}: {row.value} {row.unit}  [{row.bar}]")
    if not args.quick:
        claim = (__doc__ or "").splitlines()[0].removeprefix("Claim: ").rstrip(".")
        report = {"claim": claim, "rows": [vars(r) for r in table], "flights": runs}
        seeds = [r["seed"] for r in runs]
        print(f"-> {write_report('scene', {**report, 'seeds': seeds, **provenance()})}")


if __name__ == "__main__":
    main()
