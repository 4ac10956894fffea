# SPDX-License-Identifier: Apache-2.0
"""Draws docs/img/events.png: what an event camera sees in the `paper` flight, and what moved there.

Left the rendered light, in the middle the events of 30 ms (red ON, blue OFF), right the same events
by what caused them: movers, other vehicles with cables and load, the hall, noise.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from event_rendering import camera_of, track_of
from numpy.typing import NDArray

from skyhaul.mission.config import RunConfig
from skyhaul.sensors.events.camera import EventCamera, Pacing
from skyhaul.sensors.imaging.scene import Scene
from skyhaul.sensors.truth_track import TruthTrack
from skyhaul.types import US_PER_S, IntArray
from skyhaul.world.load import load_config

PICTURE = Path(__file__).parents[1] / "docs" / "img" / "events.png"
SPAN_US, LEAD_US, SCALE, GAP = 30_000, 60_000, 4, 12
ON, OFF, PAPER = (40, 40, 215), (200, 90, 20), (255, 255, 255)
"""Colours, in cv2's order blue, green, red."""
CAUSES = {
    "hall": (185, 185, 185), "static": (120, 120, 120), "mover": (30, 110, 240),
    "payload": (160, 60, 140), "vehicle": (90, 150, 30), "cable": (90, 150, 30),
    "noise": (0, 210, 255),
}  # fmt: skip
Colours = NDArray[np.uint8]


def gather(camera: EventCamera, track: TruthTrack, t_us: int) -> tuple[IntArray, Colours]:
    """Events of the span before a time as x, y, p, object, and the light at its end."""
    first, last = ((s - track.start_us) // 2_000 for s in (t_us - SPAN_US - LEAD_US, t_us + 22_000))
    memory, parts, light = camera.init(0), [], None
    for k in range(first, last):
        truth = track.truth(k)
        memory, r, labels = camera.step(memory, truth)
        if r is not None and labels is not None:
            inside = (r.t_us > t_us - SPAN_US) & (r.t_us <= t_us)
            parts.append(np.column_stack([r.x, r.y, r.p, labels.object_id])[inside])
        if truth.stamp_us <= t_us:
            light = camera.frame.grey.copy()
    assert light is not None
    grey = np.clip(255.0 * light, 0.0, 255.0).astype(np.uint8)
    return np.concatenate(parts).astype(np.int64), cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def colour_of(scene: Scene, object_id: int) -> tuple[int, int, int]:
    """Colour of what caused an event."""
    if object_id == -1:
        return CAUSES["noise"]
    kind = "room" if object_id < 0 else scene.kinds[object_id]
    return CAUSES["hall" if kind == "room" else kind]


def draw(scene: Scene, events: IntArray, light: Colours) -> Colours:
    """The three panels side by side, enlarged; movers are drawn last."""
    polarity, cause = (np.full(light.shape, PAPER, np.uint8) for _ in range(2))
    movers = np.array([k == "mover" for k in scene.kinds] + [False, False])
    order = np.argsort(movers[events[:, 3]], kind="stable")
    for x, y, p, o in events[order].tolist():
        polarity[y, x] = ON if p > 0 else OFF
        cause[y, x] = colour_of(scene, o)
    gap = np.full((SCALE * light.shape[0], GAP, 3), 255, np.uint8)
    size = (SCALE * light.shape[1], SCALE * light.shape[0])
    big = [cv2.resize(i, size, interpolation=cv2.INTER_NEAREST) for i in (light, polarity, cause)]
    for panel in big:
        cv2.rectangle(panel, (0, 0), (size[0] - 1, size[1] - 1), (150, 150, 150), 1)
    return np.hstack([big[0], gap, big[1], gap, big[2]])


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--track", type=Path, help="true states of a paper flight, not flown again")
    parser.add_argument("--vehicle", type=int, default=0)
    parser.add_argument("--at", type=float, default=20.0, help="end of the span [s]")
    arguments = parser.parse_args()
    config = load_config(RunConfig, "paper", ())
    track = track_of(config, arguments.track)
    camera = camera_of(config, arguments.vehicle, Pacing())
    events, light = gather(camera, track, round(arguments.at * US_PER_S))
    kinds, counts = np.unique(
        [colour_of(camera.scene, o) for o in events[:, 3]], axis=0, return_counts=True
    )
    print(
        len(events), "events;", dict(zip(map(tuple, kinds.tolist()), counts.tolist(), strict=True))
    )
    cv2.imwrite(str(PICTURE), draw(camera.scene, events, light))
    print(f"-> {PICTURE}")


if __name__ == "__main__":
    main()
