# SPDX-License-Identifier: Apache-2.0
"""What was there to be seen: pixels of each mover in each event camera, and its distance."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mover_streams import FlightStreams

from skyhaul.geometry.team_clearance import team_clearance
from skyhaul.model.envelope import team_shape
from skyhaul.sensors.camera import camera_pose
from skyhaul.sensors.imaging.frame import blank_frame
from skyhaul.sensors.imaging.lens import make_lens
from skyhaul.sensors.imaging.raycast import render
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.types import Array, IntArray

LOOK_US = 20_000


@dataclass(frozen=True, eq=False)
class Seen:
    """At times LOOK_US apart, k of them; n vehicles, m movers."""

    row: IntArray  # (k,) of the truth
    pixels: IntArray  # (k, n, m) unoccluded, in the event camera of each vehicle
    clearance: Array  # (k, m) from the team's shape to the mover's surface [m]


def seen(flight: FlightStreams, movers: dict[int, int], kept: Path) -> Seen:
    """Render and measure, or take from the file what was measured before."""
    if not kept.exists():
        part = kept.with_name(kept.name + ".part")
        with part.open("wb") as file:
            found = _measure(flight, movers)
            np.savez_compressed(file, row=found.row, pixels=found.pixels, clearance=found.clearance)
        part.replace(kept)
    with np.load(kept) as f:
        return Seen(f["row"], f["pixels"], f["clearance"])


def _measure(flight: FlightStreams, movers: dict[int, int]) -> Seen:
    config, truth = flight.config, flight.truth
    scene, calibration = build_scene(config.team, config.world), config.sensors.rig.calibration()
    camera = calibration.event_camera
    assert camera is not None
    lens = make_lens(camera.model)
    frame, shape = blank_frame(scene.arrays, lens), team_shape(config.team, 0.0)
    rows = np.flatnonzero(truth.t_us % LOOK_US == 0)
    pixels = np.zeros((len(rows), config.team.count, len(movers)), np.int64)
    clearance = np.zeros((len(rows), len(movers)))
    for a, k in enumerate(rows.tolist()):
        now = truth.truth(k)
        scene.pose(now)
        for i in range(config.team.count):
            p_WC, R_WC = camera_pose(camera, now, i)
            render(scene.arrays, lens, p_WC, R_WC, scene.vehicle_id(i), frame)
            count = np.bincount(np.maximum(frame.object_id.ravel(), 0), minlength=256)
            pixels[a, i] = [count[label] for label in movers]
        o = now.obstacles
        for b, j in enumerate(movers.values()):
            clearance[a, b] = team_clearance(
                shape.radius_m, shape.above_m, shape.below_m, now.team.p_WL,
                int(o.kind[j]), o.size[j], o.p_WO[j], o.R_WO[j],
            )  # fmt: skip
    return Seen(rows, pixels, clearance)
