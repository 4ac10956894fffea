# SPDX-License-Identifier: Apache-2.0
"""Draws the pictures of docs/sensors.md: what the cameras of a vehicle see, and what they cover."""

from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps
from matplotlib.patches import Wedge
from numpy.typing import NDArray
from recorded_truth import flight, truths

from skyhaul.geometry.camera import in_frame, pixel_rays, project_points
from skyhaul.plant.api import Truth
from skyhaul.sensors.api import CameraCalibration
from skyhaul.sensors.camera import Cameras, cameras
from skyhaul.sensors.imaging.arrays import SKY
from skyhaul.sensors.imaging.frame import Frame, z_depth
from skyhaul.sensors.imaging.scene import build_scene
from skyhaul.sensors.rig import RigParams
from skyhaul.types import Array

IMAGES = Path(__file__).parents[1] / "docs" / "img"
MOMENT_S, VEHICLE = 13.75, 3
"""When, and through whose cameras [s]."""
Picture = NDArray[np.uint8]


def quad(pictures: list[Picture]) -> Picture:
    """Four pictures two by two, twice as large, with a thin line between."""
    big = [cv2.resize(p, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST) for p in pictures]
    padded = [cv2.copyMakeBorder(p, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255,) * 3) for p in big]
    return np.vstack([np.hstack(padded[:2]), np.hstack(padded[2:])])


def label(picture: Picture, words: str) -> Picture:
    """The picture in colour with a name in its corner."""
    out = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    cv2.rectangle(out, (0, 0), (6 * len(words) + 9, 15), (0, 0, 0), -1)
    cv2.putText(
        out, words, (4, 11), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (255, 255, 255), 1, cv2.LINE_AA
    )
    return out


def depth_picture(team: Cameras, c: int, frame: Frame) -> Picture:
    """Depth along the optical axis, near bright, 0.5 to 15 m in equal ratios; sky white."""
    depth = z_depth(team.lenses[c], frame)
    near = 1.0 - np.log(np.clip(depth, 0.5, 15.0) / 0.5) / np.log(30.0)
    rgb = colormaps["magma"](0.08 + 0.9 * near)[..., :3]
    rgb[~np.isfinite(depth)] = 1.0
    return np.ascontiguousarray((255 * rgb[..., ::-1]).astype(np.uint8))


def id_picture(kinds: tuple[str, ...], frame: Frame) -> Picture:
    """A colour of its own for every object, shaded by its grey."""
    base = {
        "room": (0.55, 0.58, 0.62), "static": (0.45, 0.35, 0.25), "mover": (0.85, 0.2, 0.2),
        "vehicle": (0.15, 0.45, 0.85), "payload": (0.2, 0.65, 0.3), "cable": (0.95, 0.75, 0.1),
    }  # fmt: skip
    table = np.ones((len(kinds) + 1, 3))
    for o, kind in enumerate(kinds):
        table[o] = np.array(base[kind]) * (0.72 + 0.28 * ((o * 0.37) % 1.0))
    ids = np.where(frame.object_id == SKY, len(kinds), frame.object_id)
    rgb = table[ids] * (0.65 + 0.35 * np.clip(frame.grey, 0.0, 1.0))[..., None]
    return np.ascontiguousarray((255 * rgb[..., ::-1]).astype(np.uint8))


def draw_views(team: Cameras, truth: Truth) -> None:
    """Grey, depth and object ids of the four cameras."""
    memory = team.init(0)
    start = truth.stamp_us // 100_000 * 100_000 + team.lag_us
    for k in range(8):  # until exposure has settled
        memory, frames = team.step(memory, replace(truth, stamp_us=start + 100_000 * k))
    names = [m.name for m in team.mounts]
    greys = [label(f.image.copy(), n) for f, n in zip(frames, names, strict=True)]
    cv2.imwrite(str(IMAGES / "sensors_cameras.jpg"), quad(greys))
    views = [team.look(c, truth) for c in range(4)]
    depths = [label(depth_picture(team, c, v), names[c]) for c, v in enumerate(views)]
    cv2.imwrite(str(IMAGES / "sensors_depth.png"), quad(depths))
    ids = [label(id_picture(team.scene.kinds, v), names[c]) for c, v in enumerate(views)]
    cv2.imwrite(str(IMAGES / "sensors_ids.jpg"), quad(ids))


def covered(camera: CameraCalibration, d_B: Array) -> NDArray[np.bool_]:
    """Which directions (k, 3) of body axes a camera sees, far away."""
    uv, ok = project_points(camera.model, d_B @ camera.R_BC)
    arrays = camera.model.arrays()
    return ok & np.array([in_frame(arrays, u, v) for u, v in uv])


def draw_rig(rig: RigParams) -> None:
    """The rig from above, and the directions each camera covers."""
    calibration = rig.calibration()
    assert calibration.event_camera is not None
    every = [*calibration.cameras, calibration.event_camera]
    colours = ["tab:blue", "tab:cyan", "tab:red", "tab:green", "tab:purple"]
    figure, (above, sphere) = plt.subplots(1, 2, figsize=(13.5, 5.2), width_ratios=(1.0, 1.55))
    for camera, colour in zip(every, colours, strict=True):
        rays = pixel_rays(camera.model)[camera.model.size_px[1] // 2] @ camera.R_BC.T
        left, right = (np.degrees(np.arctan2(r[1], r[0])) for r in (rays[0], rays[-1]))
        reach = 0.22 if camera is every[-1] else 0.16
        place = (-camera.p_BC[1], camera.p_BC[0])
        above.add_patch(Wedge(place, reach, right + 90, left + 90, color=colour, alpha=0.3))
        above.plot(*place, "o", color=colour, label=camera.name)
    for k in (45, 135, 225, 315):
        x, y = 0.1 * np.cos(np.radians(k)), 0.1 * np.sin(np.radians(k))
        above.plot([0, x], [0, y], color="0.4", lw=3, zorder=0)
        above.add_patch(plt.Circle((x, y), 0.05, fill=False, color="0.4"))
    above.annotate("load hangs\nbehind, below", (0, -0.2), ha="center", fontsize=9, color="0.3")
    above.arrow(0, 0.02, 0, 0.06, head_width=0.012, color="k")
    above.set(xlim=(-0.28, 0.28), ylim=(-0.28, 0.28), aspect="equal", title="from above, x forward",
              xlabel="right [m]", ylabel="forward [m]")  # fmt: skip
    above.legend(loc="upper right", fontsize=8)
    azimuth, elevation = np.meshgrid(np.arange(-180.0, 181.0, 2), np.arange(-90.0, 91.0, 2))
    a, e = np.radians(azimuth.ravel()), np.radians(elevation.ravel())
    d = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    for camera, colour in zip(every, colours, strict=True):
        seen = covered(camera, d).reshape(azimuth.shape).astype(float)
        sphere.contourf(-azimuth, elevation, seen, levels=[0.5, 1.5], colors=[colour], alpha=0.25)
        sphere.contour(-azimuth, elevation, seen, levels=[0.5], colors=[colour], linewidths=1.5)
    for side in (-45.0, 0.0, 45.0):
        sphere.plot((180.0 + side + 180.0) % 360.0 - 180.0, -64.0, "r^", ms=8)
    sphere.annotate("the load hangs here", (78, -75), fontsize=9, color="r")
    sphere.set(xlim=(-180, 180), ylim=(-90, 90), xlabel="azimuth to the right [deg]",
               ylabel="elevation [deg]", title="directions that each camera covers",
               xticks=range(-180, 181, 45), yticks=range(-90, 91, 30))  # fmt: skip
    sphere.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(IMAGES / "sensors_rig.png", dpi=80)


def main() -> None:
    """Draw everything."""
    draw_rig(RigParams())
    run, _ = flight(__doc__)
    truth = truths(run)(int(np.searchsorted(run.t_s, MOMENT_S)))
    scene = build_scene(run.scenario.team, run.scenario.world)
    team = cameras(RigParams(), scene, run.scenario.world.light, VEHICLE, run.scenario.team.count)
    draw_views(team, truth)


if __name__ == "__main__":
    main()
