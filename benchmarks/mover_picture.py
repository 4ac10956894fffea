# SPDX-License-Identifier: Apache-2.0
"""Draws docs/img/mover_tracks.png: a `crossing` flight from above, its movers and their tracks.

Movers' events are told by the label channel, as in `mover_tracks.py --classifier labels`.
"""

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from mover_chain import mover_labels, sights, team_watch
from mover_streams import streams
from mover_truth import seen

from skyhaul.perception.obstacles.from_events import EventObstacles

mpl.use("Agg")
from matplotlib import pyplot as plt

PICTURE = Path(__file__).parents[1] / "docs" / "img" / "mover_tracks.png"
REACH_M, UNSURE_M, SEED, EVERY = 7.0, 0.5, 1, 5


def main() -> None:
    """Run the chain over a flight and draw."""
    parser = argparse.ArgumentParser(description="movers and their tracks from above")
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/streams"))
    folder = parser.parse_args().folder
    flight = streams("crossing", SEED, folder)
    movers = mover_labels(flight)
    looks = seen(flight, movers, folder / f"crossing-{SEED}.seen.npz")
    watch = team_watch(flight, EventObstacles(), labels=True)
    memory, rows = watch.init(), []
    for n, (_, sight) in enumerate(sights(flight)):
        memory, estimate = watch.step(memory, sight)
        if n % EVERY == 0:
            for t in estimate.tracks:
                unsure = float(np.sqrt(np.linalg.eigvalsh(t.covariance[:3, :3])[-1]))
                rows.append((t.track_id, sight.stamp_us, *t.p_WO[:2], unsure))
    draw(flight.truth, movers, looks, np.array(rows))


def draw(truth: Any, movers: dict[int, int], looks: Any, rows: Any) -> None:  # noqa: ANN401
    """Ways in grey, tracks in colour, pale where they are unsure."""
    figure, axes = plt.subplots(figsize=(11, 7.5), dpi=110)
    axes.plot(*truth.p_WL[:, :2].T, color="black", lw=2.5, label="the load")
    for b, j in enumerate(movers.values()):
        near = np.interp(np.arange(len(truth)), looks.row, looks.clearance[:, b]) < REACH_M
        way = np.where(near[:, None], truth.p_WO[:, j, :2], np.nan)
        label = "movers within 7 m, truth" if b == 0 else None
        axes.plot(*way.T, color="0.75", lw=9, solid_capstyle="round", label=label, zorder=0)
    names, counts = np.unique(rows[:, 0], return_counts=True)
    long = [n for n, c in zip(names, counts, strict=True) if c >= 8]
    for name, colour in zip(long, plt.get_cmap("tab20")(np.arange(20)), strict=False):
        mine = rows[rows[:, 0] == name]
        sure = mine[:, 4] < UNSURE_M
        axes.plot(mine[sure, 2], mine[sure, 3], ".", ms=5, color=colour)
        axes.plot(mine[~sure, 2], mine[~sure, 3], "x", ms=4, mew=0.7, color=colour, alpha=0.5)
    axes.plot([], [], ".", color="0.3", label="tracks, one colour a name, every 50 ms")
    axes.plot([], [], "x", color="0.3", label="the same, unsure by more than 0.5 m")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-2, 19), ylim=(-9, 9))
    axes.legend(loc="upper left", framealpha=0.95)
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(PICTURE)


if __name__ == "__main__":
    main()
