# SPDX-License-Identifier: Apache-2.0
"""The truth of a whole flight, kept exactly, so that sensors can be simulated after it."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from skyhaul.errors import FileError
from skyhaul.geometry.shapes import ShapeArrays
from skyhaul.model.state import CableState, TeamState
from skyhaul.plant.api import PLANT_STEP_US, Truth
from skyhaul.types import Array, IntArray, Mask, TimeUs, frozen
from skyhaul.whole import whole

_CHUNK = 2_048


@dataclass(frozen=True, eq=False)
class TruthTrack:
    """Truth at m consecutive steps of the plant, n vehicles, o obstacles.

    Everything of `Truth` but its contacts, bit for bit.
    """

    start_us: TimeUs  # of the first row
    p_WL: Array  # (m, 3) [m]
    q_WL: Array  # (m, 4)
    v_WL: Array  # (m, 3) [m/s]
    w_WL_L: Array  # (m, 3) [rad/s]
    p_WB: Array  # (m, n, 3) [m]
    q_WB: Array  # (m, n, 4)
    v_WB: Array  # (m, n, 3) [m/s]
    w_WB_B: Array  # (m, n, 3) [rad/s]
    cable_dir_W: Array  # (m, n, 3)
    cable_w_W: Array  # (m, n, 3) [rad/s]
    tension: Array  # (m, n) [N]
    length: Array  # (m, n) [m]
    attached: Mask  # (m, n)
    alive: Mask  # (m, n)
    rotor_thrust: Array  # (m, n, 4) [N]
    accel_W: Array  # (m, 1 + n, 3) [m/s^2]
    p_WO: Array  # (m, o, 3) [m]
    v_WO: Array  # (m, o, 3) [m/s]
    present: Mask  # (m, o)
    wind_W: Array  # (m, 3) [m/s]
    clearance_m: Array  # (m,) [m]
    obstacle_kind: IntArray  # (o,)
    obstacle_size: Array  # (o, 3) [m]
    obstacle_R_WO: Array  # (o, 3, 3) obstacles do not turn

    def __post_init__(self) -> None:
        frozen(*(getattr(self, name) for name in _ROWS))

    def __len__(self) -> int:
        return len(self.p_WL)

    @property
    def t_us(self) -> IntArray:
        """Times of the rows, (m,) [us]."""
        return self.start_us + PLANT_STEP_US * np.arange(len(self), dtype=np.int64)

    def truth(self, k: int) -> Truth:
        """Row k, without contacts."""
        shapes = ShapeArrays(
            self.obstacle_kind, self.obstacle_size, self.p_WO[k].copy(), self.obstacle_R_WO
        )  # writable like the plant's, so that kernels see one type only
        return Truth(
            stamp_us=self.start_us + k * PLANT_STEP_US,
            team=TeamState(
                self.p_WL[k], self.q_WL[k], self.v_WL[k], self.w_WL_L[k],
                self.p_WB[k], self.q_WB[k], self.v_WB[k], self.w_WB_B[k],
            ),
            cables=CableState(
                self.cable_dir_W[k], self.cable_w_W[k], self.tension[k], self.length[k]
            ),
            attached=self.attached[k],
            alive=self.alive[k],
            rotor_thrust=self.rotor_thrust[k],
            accel_W=self.accel_W[k],
            obstacles=shapes,
            v_WO=self.v_WO[k],
            present=self.present[k],
            wind_W=self.wind_W[k],
            clearance_m=float(self.clearance_m[k]),
            contacts=(),
        )  # fmt: skip

    def truths(self) -> Iterator[Truth]:
        """All rows, in order."""
        return (self.truth(k) for k in range(len(self)))

    def save(self, path: Path) -> None:
        """Write to a file; a reader finds all of it or nothing.

        Raises:
            FileError: When it cannot be written.
        """
        columns: dict[str, Any] = {name: getattr(self, name) for name in _ROWS + _ONCE}
        try:
            with whole(path) as part, part.open("wb") as file:
                np.savez(file, start_us=self.start_us, **columns)
        except OSError as fault:
            raise FileError(f"{path} cannot be written: {fault.strerror}") from fault


_ONCE = ("obstacle_kind", "obstacle_size", "obstacle_R_WO")
_ROWS = tuple(f for f in TruthTrack.__dataclass_fields__ if f not in ("start_us", *_ONCE))


def load_track(path: Path) -> TruthTrack:
    """A track from its file.

    Raises:
        FileError: When it is missing or not a track.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            columns = {name: file[name] for name in _ROWS + _ONCE}
            return TruthTrack(start_us=int(file["start_us"]), **columns)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as fault:
        raise FileError(f"{path} is no track of a flight: {fault}") from None


class TrackWriter:
    """Collects a track while a flight goes on."""

    def __init__(self) -> None:
        self._chunks: list[dict[str, NDArray[Any]]] = []
        self._filled = _CHUNK
        self._first: Truth | None = None

    def add(self, truth: Truth) -> None:
        """Take down one step of the plant."""
        if self._first is None:
            self._first = truth
        row = _columns(truth)
        if self._filled == _CHUNK:
            self._chunks.append(
                {name: np.empty((_CHUNK, *v.shape), v.dtype) for name, v in row.items()}
            )
            self._filled = 0
        chunk = self._chunks[-1]
        for name, value in row.items():
            chunk[name][self._filled] = value
        self._filled += 1

    def track(self) -> TruthTrack:
        """What has been collected.

        Raises:
            FileError: When nothing has been.
        """
        if self._first is None:
            raise FileError("nothing was recorded: the flight has no step")
        rows = {
            name: np.concatenate(
                [c[name] for c in self._chunks[:-1]] + [self._chunks[-1][name][: self._filled]]
            )
            for name in _ROWS
        }
        shapes = self._first.obstacles
        return TruthTrack(
            start_us=self._first.stamp_us,
            **rows,
            obstacle_kind=shapes.kind.copy(),
            obstacle_size=shapes.size.copy(),
            obstacle_R_WO=shapes.R_WO.copy(),
        )


def _columns(truth: Truth) -> dict[str, NDArray[Any]]:
    team, cables = truth.team, truth.cables
    return {
        "p_WL": team.p_WL,
        "q_WL": team.q_WL,
        "v_WL": team.v_WL,
        "w_WL_L": team.w_WL_L,
        "p_WB": team.p_WB,
        "q_WB": team.q_WB,
        "v_WB": team.v_WB,
        "w_WB_B": team.w_WB_B,
        "cable_dir_W": cables.dir_W,
        "cable_w_W": cables.w_W,
        "tension": cables.tension,
        "length": cables.length,
        "attached": truth.attached,
        "alive": truth.alive,
        "rotor_thrust": truth.rotor_thrust,
        "accel_W": truth.accel_W,
        "p_WO": truth.obstacles.p_WO,
        "v_WO": truth.v_WO,
        "present": truth.present,
        "wind_W": truth.wind_W,
        "clearance_m": np.array(truth.clearance_m),
    }
