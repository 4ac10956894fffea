# SPDX-License-Identifier: Apache-2.0
"""Draws docs/img/loop_closure.png: a flight there and back, its odometry, and the map with loops.

Above the way along the hall, below the error of the position; ticks mark keyframes whose place was
recognised.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from loop_closure import flight_job, follow
from vio_flight_data import fly_track, seen_of

from skyhaul.perception.slam.loops import LoopRules
from skyhaul.perception.vio.vehicle import VehicleVio, rig_of

PICTURE = Path(__file__).parents[1] / "docs" / "img" / "loop_closure.png"
WAY_M, SEED = 120, 0
ALONE, MAPPED, TRUE = "#e08a3c", "#3c78b4", "#909090"


def main() -> None:
    """Follow the flight and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, default=Path("build/loop_closure"))
    work = parser.parse_args().work
    work.mkdir(parents=True, exist_ok=True)
    job, vio = flight_job(WAY_M, SEED), VehicleVio()
    fly_track(job, work)
    seen, calibration = seen_of(job, 0, work), job.config().sensors.calibration()
    lenses = vio.build(calibration).tracker.lenses
    c = follow(LoopRules().build(rig_of(calibration), lenses), job, seen, vio)
    figure, (top, low) = plt.subplots(2, 1, figsize=(10.0, 5.0), sharex=True, layout="constrained")
    top.plot(c.t_s, c.true[:, 0], color=TRUE, lw=3.0, label="true")
    top.plot(c.t_s, c.true[:, 0] + c.alone[:, 0], color=ALONE, lw=1.2, label="odometry alone")
    top.plot(c.t_s, c.true[:, 0] + c.mapped[:, 0], color=MAPPED, lw=1.2, label="with loops closed")
    top.set(ylabel="x along the hall [m]")
    top.legend(frameon=False, loc="upper right")
    for error, color in ((c.alone, ALONE), (c.mapped, MAPPED)):
        low.plot(c.t_s, 100.0 * np.linalg.norm(error, axis=1), color=color, lw=1.6)
    seen_s = [1e-6 * c.memory.places[loop.j].stamp_us for loop in c.memory.loops]
    low.plot(seen_s, np.zeros(len(seen_s)), "|", color="#444444", ms=9, label="place recognised")
    low.set(xlabel="time [s]", ylabel="error of position [cm]", ylim=(-4.0, None))
    low.legend(frameon=False, loc="upper left")
    for axes in (top, low):
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlim(0.0, c.t_s[-1])
    figure.savefig(PICTURE, dpi=110)
    print(f"-> {PICTURE}")


if __name__ == "__main__":
    main()
