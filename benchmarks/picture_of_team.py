# SPDX-License-Identifier: Apache-2.0
"""Draws docs/img/team_state.png: a flight of `paper`, what the team knows of itself and the truth.

Left the errors of position of the vehicles' own odometry, of the vehicles in the team's frame and
of the load; right the tension of one cable through lift-off, estimated and true.
"""

import argparse
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from team_recordings import record
from team_state import Case, run

PICTURE = Path(__file__).parents[1] / "docs" / "img" / "team_state.png"
OWN, TEAM, LOAD, TRUE = "#e08a3c", "#3c78b4", "#222222", "#b0b0b0"


def main() -> None:
    """Run the filter over the flight and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    work = Path(tempfile.gettempdir()) / "skyhaul_team_state"
    parser.add_argument("--work", type=Path, default=work, help="keeps flights")
    recording = record("paper", 0, parser.parse_args().work)
    errors = run(recording, Case(seed=0))
    t = 2e-3 * np.arange(len(errors.load))
    own = 100.0 * np.linalg.norm(np.array(errors.odometry), axis=2)
    team = 100.0 * np.linalg.norm(np.array(errors.vehicles), axis=2)
    load = 100.0 * np.linalg.norm(np.array(errors.load)[:, :3], axis=1)
    cables = np.array(errors.rows)
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.4), layout="constrained")
    left.plot(t, own, color=OWN, lw=1.0, label=[*["vehicles' own odometry"], *[None] * 3])
    left.plot(t, team, color=TEAM, lw=1.0, label=[*["vehicles in the team's frame"], *[None] * 3])
    left.plot(t, load, color=LOAD, lw=1.6, label="load")
    left.set(
        xlabel="time [s]", ylabel="error of position [cm]", xlim=(0.0, t[-1]), ylim=(0.0, None)
    )
    left.legend(frameon=False, loc="upper left")
    left.set_title("Where they are: seed 0 of `paper`, modelled odometry", fontsize=10)
    lift = int(np.argmax(cables[:, 0, 3] > 0.0))
    rows = slice(max(0, lift - 500), lift + 1500)
    right.plot(t[rows], cables[rows, 0, 2], color=TEAM, lw=0.8, label="estimated, 500 Hz")
    right.plot(t[rows], cables[rows, 0, 3], color=LOAD, lw=1.6, label="true")
    right.set(xlabel="time [s]", ylabel="tension of cable 0 [N]", xlim=(t[rows][0], t[rows][-1]))
    right.legend(frameon=False, loc="lower right")
    right.set_title("What a cable pulls: slack, spooled up, lifted", fontsize=10)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color=TRUE, alpha=0.3, lw=0.5)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=110)
    print(f"-> {PICTURE}")


if __name__ == "__main__":
    main()
