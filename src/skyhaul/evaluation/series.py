# SPDX-License-Identifier: Apache-2.0
"""A recorded run, read back: series as arrays, events as lists. Needs only the run folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyhaul.errors import FileError
from skyhaul.evaluation.columns import Layout
from skyhaul.evaluation.events import Events, read_events
from skyhaul.evaluation.folder import STATES, Origin, read_config
from skyhaul.types import US_PER_S, Array, Mask
from skyhaul.world.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Run:
    """Everything a run folder holds. k rows at 100 Hz, n vehicles, m moving obstacles."""

    folder: Path
    scenario: Scenario
    origin: Origin
    layout: Layout
    phases: tuple[str, ...]
    """Names that `series["phase"]` indexes."""
    series: dict[str, Array]
    """Arrays (k, ...) by the keys of `columns.Layout.blocks`, for example `load`, (k, 13)."""
    events: Events

    @property
    def t_s(self) -> Array:
        """Times of the rows, (k,) [s]."""
        return self.series["t"] / US_PER_S

    @property
    def airborne(self) -> Mask:
        """Rows after lift-off, (k,)."""
        return self.series["airborne"] > 0.0

    @property
    def carrying(self) -> Mask:
        """Cables that carry: joined to the load and to a vehicle that is alive, (k, n)."""
        return (self.series["cable_attached"] > 0.0) & (self.series["vehicle_alive"] > 0.0)

    @property
    def phase_spans(self) -> list[tuple[str, float, float]]:
        """Phases with their begin and end [s]."""
        if not len(self.t_s):
            return []
        code = self.series["phase"].astype(np.int64)
        starts = np.flatnonzero(np.diff(code, prepend=-1))
        ends = np.append(starts[1:], len(code) - 1)
        t = self.t_s
        return [
            (self.phases[code[a]], float(t[a]), float(t[b]))
            for a, b in zip(starts, ends, strict=True)
        ]


def load_run(folder: Path | str) -> Run:
    """Read a run folder, also that of a run that was killed.

    Raises:
        FileError: when the folder holds no run, or a file in it is broken.
    """
    path = Path(folder)
    scenario, origin = read_config(path)
    table = _read_states(path / STATES)
    about = {k.decode(): v.decode() for k, v in (table.schema.metadata or {}).items()}
    layout = Layout.from_json(about["layout"])
    return Run(
        folder=path,
        scenario=scenario,
        origin=origin,
        layout=layout,
        phases=tuple(about["phases"].split(",")),
        series=_blocks(table, layout),
        events=read_events(path),
    )


def _read_states(path: Path) -> pa.Table:
    if not path.is_file():
        raise FileError(f"{path.parent} is no run folder: it has no {path.name}")
    try:
        return pq.read_table(path)
    except pa.ArrowInvalid as fault:
        raise FileError(f"{path} is broken: {str(fault).splitlines()[0]}") from fault


def _blocks(table: pa.Table, layout: Layout) -> dict[str, Array]:
    """Columns gathered to one array per block."""
    k = table.num_rows
    out: dict[str, Array] = {}
    for key, block in layout.blocks.items():
        data = np.empty((k, len(block.names)))
        for j, name in enumerate(block.names):
            data[:, j] = table.column(name).to_numpy()
        out[key] = data.reshape(k, *block.shape)
    return out
