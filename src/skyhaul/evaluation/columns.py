# SPDX-License-Identifier: Apache-2.0
"""Layout of `states.parquet`: which quantity stands in which columns, with units in the names.

A block is one array per row, for example the positions of all vehicles, (n, 3); its columns are
neighbours, in row-major order. Units: m, mps, mps2, rad, radps, n, nm, j, s, us; `nd` has none.
"""

import json
from dataclasses import dataclass
from functools import cached_property

from skyhaul.types import TimeUs

ROW_PERIOD_US: TimeUs = 10_000
"""Time between two rows [us]."""

LOAD_FIELDS = (
    *("x_m", "y_m", "z_m", "qw_nd", "qx_nd", "qy_nd", "qz_nd"),
    *("vx_mps", "vy_mps", "vz_mps", "wx_radps", "wy_radps", "wz_radps"),
)
"""Columns of a load state, in the layout of `types.LOAD_P` and its neighbours."""
Row = tuple[str, tuple[int, ...], tuple[str, ...]]
XYZ_M = ("x_m", "y_m", "z_m")


@dataclass(frozen=True)
class Block:
    """One quantity: its key, the shape of its array per row and its columns."""

    key: str
    shape: tuple[int, ...]
    names: tuple[str, ...]
    start: int
    """Index of its first column."""

    @property
    def columns(self) -> slice:
        """Its columns."""
        return slice(self.start, self.start + len(self.names))


@dataclass(frozen=True)
class Layout:
    """All columns for n vehicles and for the obstacles that are not always there or move."""

    n: int
    """Number of vehicles."""
    movers: tuple[int, ...]
    """Indices of the obstacles whose pose is logged."""

    @cached_property
    def blocks(self) -> dict[str, Block]:
        """Blocks by key, in the order of the columns."""
        out: dict[str, Block] = {}
        start = 0
        for key, shape, names in self._rows():
            out[key] = Block(key, shape, names, start)
            start += len(names)
        return out

    @property
    def names(self) -> list[str]:
        """All column names, in order."""
        return [name for block in self.blocks.values() for name in block.names]

    def to_json(self) -> str:
        """The layout as text, for the metadata of the file."""
        return json.dumps({"vehicles": self.n, "movers": list(self.movers)})

    @staticmethod
    def from_json(text: str) -> "Layout":
        """Read what `to_json` wrote."""
        data = json.loads(text)
        return Layout(int(data["vehicles"]), tuple(int(j) for j in data["movers"]))

    def _rows(self) -> list[Row]:
        n = self.n
        rows: list[Row] = [(key, (), (name,)) for key, name in _SCALARS]
        rows += [(key, (13,), _named(key, LOAD_FIELDS)) for key in ("load", "ref", "est")]
        rows.append(("wind", (3,), ("wind_x_mps", "wind_y_mps", "wind_z_mps")))
        rows += [(f"vehicle_{k}", (n, len(c)), _each("vehicle", n, c)) for k, c in _VEHICLE]
        rows += [(f"vehicle_{k}", (n,), _each("vehicle", n, (c,))) for k, c in _VEHICLE_SCALARS]
        rows += [(f"cable_{k}", (n, len(c)), _each("cable", n, c)) for k, c in _CABLE]
        rows += [(f"cable_{k}", (n,), _each("cable", n, (c,))) for k, c in _CABLE_SCALARS]
        m = len(self.movers)
        places = tuple(f"obstacle{j}_{c}" for j in self.movers for c in XYZ_M)
        present = tuple(f"obstacle{j}_present_nd" for j in self.movers)
        return [*rows, ("obstacle_p", (m, 3), places), ("obstacle_present", (m,), present)]


def _named(prefix: str, fields: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{prefix}_{f}" for f in fields)


def _each(kind: str, n: int, fields: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{kind}{i}_{f}" for i in range(n) for f in fields)


_SCALARS = (
    ("t", "t_us"),
    ("phase", "phase_code_nd"),  # index in mission.api.Phase
    ("airborne", "airborne_nd"),  # 1 after lift-off
    ("clearance_min", "clearance_min_m"),  # least of all steps since the row before
    ("vehicle_distance_min", "vehicle_distance_min_m"),  # centres, flying vehicles, likewise
    ("rotor_energy", "rotor_energy_j"),  # since the start
    ("slack", "slack_s"),  # time with a slack cable since lift-off
)
_VEHICLE = (
    ("p", XYZ_M),
    ("q", ("qw_nd", "qx_nd", "qy_nd", "qz_nd")),
    ("v", ("vx_mps", "vy_mps", "vz_mps")),
    ("w", ("wx_radps", "wy_radps", "wz_radps")),
    ("rotor", tuple(f"rotor{r}_n" for r in range(4))),
    ("rotor_cmd", tuple(f"rotor{r}_cmd_n" for r in range(4))),
    ("moment_cmd", ("moment_x_cmd_nm", "moment_y_cmd_nm", "moment_z_cmd_nm")),
)
_VEHICLE_SCALARS = (
    ("thrust_max", "thrust_max_n"),  # largest since the row before
    ("thrust_cmd", "thrust_cmd_n"),
    ("thrust_plan", "thrust_plan_n"),
    ("alive", "alive_nd"),
)
_CABLE = (
    ("dir", ("dx_nd", "dy_nd", "dz_nd")),
    ("w", ("wx_radps", "wy_radps", "wz_radps")),
    ("dir_flat", ("flat_dx_nd", "flat_dy_nd", "flat_dz_nd")),
    ("force_cmd", ("fx_cmd_n", "fy_cmd_n", "fz_cmd_n")),
    ("force_plan", ("fx_plan_n", "fy_plan_n", "fz_plan_n")),
)
_CABLE_SCALARS = (
    ("tension", "tension_n"),
    ("tension_min", "tension_min_n"),  # of all steps since the row before
    ("tension_max", "tension_max_n"),
    ("length", "length_m"),
    ("attached", "attached_nd"),
)
