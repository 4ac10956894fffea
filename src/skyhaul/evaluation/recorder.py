# SPDX-License-Identifier: Apache-2.0
"""Takes a flight down into its run folder."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from skyhaul.comms.api import Envelope
from skyhaul.errors import FileError
from skyhaul.evaluation import extremes, folder
from skyhaul.evaluation.columns import ROW_PERIOD_US, Layout
from skyhaul.evaluation.energy import EnergyModel, rotor_power_factor
from skyhaul.evaluation.events_log import EventsLog
from skyhaul.evaluation.mcap_log import McapLog
from skyhaul.evaluation.parquet_log import GrowingParquet
from skyhaul.evaluation.team_log import TeamLog
from skyhaul.mapping.api import WorldMap
from skyhaul.mission.api import LIFTED_M, PULLING, Outcome, Phase, Replan, Solve, Tick, Trigger
from skyhaul.planning.api import Reference
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.types import US_PER_S, TimeUs
from skyhaul.world.check import rest_height_m
from skyhaul.world.scenario import Scenario

GROUP_ROWS = 250
"""Rows per row group: a killed run loses at most 2.5 s of its series."""

PHASES = tuple(Phase)
"""`phase_code_nd` counts in this order."""


class RunRecorder:
    """Implements `mission.api.Recorder`: `config.yaml`, `log.mcap` and `states.parquet`.

    Rows of the series are written at 100 Hz; extremes and integrals are followed at every step,
    so that no row period hides one. No wall time enters the series: same flight, same bytes.
    """

    def __init__(
        self, path: Path, config: Scenario, seed: int, energy: EnergyModel | None = None
    ) -> None:
        self._made = folder.create(path, config, folder.origin(seed))
        self.folder = path
        n = config.team.count
        obstacles = config.world.obstacles
        moving = [j for j, o in enumerate(obstacles) if o.motion.kind != "static" or o.appears]
        self._layout = Layout(n, tuple(moving))
        self._movers = np.array(moving, dtype=np.int64)
        self._quantities = [self._reader(key) for key in self._layout.blocks]
        self._table, self._count = np.empty((GROUP_ROWS, len(self._layout.names))), 0
        try:
            self._states = GrowingParquet(path / folder.STATES, _schema(self._layout))
            self._log = McapLog(path / folder.LOG)
        except FileError:
            folder.remove(path, self._made)
            raise
        self._team_log = TeamLog(self._log, config, self._movers)
        self._events = EventsLog(self._log)
        radius = config.team.vehicle.rotor_radius_m
        factor = rotor_power_factor(energy or EnergyModel(), radius)
        self._power_step = factor * PLANT_STEP_US / US_PER_S
        self._extremes = extremes.start(n)
        self._rest_m = rest_height_m(config.team)
        self._phase: Phase | None = None
        self._airborne = False
        self._now_us: TimeUs = 0

    def tick(self, tick: Tick) -> None:
        """Every plant step."""
        truth = tick.truth
        t_us = self._now_us = truth.stamp_us
        airborne = self._airborne or self._lifts_off(tick)
        if tick.phase is not self._phase or airborne != self._airborne:
            self._enter(tick.phase, airborne, t_us)
        extremes.follow(
            self._extremes,
            truth.clearance_m,
            truth.team.p_WB,
            truth.rotor_thrust,
            truth.cables.tension,
            truth.attached,
            truth.alive,
            self._power_step,
            PLANT_STEP_US / US_PER_S if self._airborne else 0.0,
        )
        for contact in truth.contacts:
            self._events.contact(contact, self._airborne, truth)
        if t_us % ROW_PERIOD_US == 0:
            self._add_row(tick)
        self._team_log.tick(tick)

    def trigger(self, trigger: Trigger) -> None:
        """Something fired."""
        self._events.trigger(trigger)

    def replan(self, replan: Replan) -> None:
        """A reference was planned, accepted or not."""
        self._events.replan(replan)

    def reference(self, stamp_us: TimeUs, reference: Reference) -> None:
        """A reference came into force."""
        self._events.reference(stamp_us, reference)

    def solve(self, solve: Solve) -> None:
        """A control plan was solved."""
        self._events.solve(solve)

    def map(self, world_map: WorldMap) -> None:
        """M(t) changed."""
        self._events.map(world_map)

    def message(self, envelope: Envelope[object]) -> None:
        """A message went over the bus."""
        self._events.message(envelope)

    def close(self, outcome: Outcome) -> None:
        """The flight is over, or was interrupted; called exactly once.

        Raises:
            FileError: When the disk refuses; what was written before can be read.
        """
        with ExitStack() as closing:
            closing.callback(self._log.close)
            closing.callback(self._states.close)
            closing.callback(self._end, outcome)
            self._flush()

    def withdraw(self) -> bool:
        """Remove the run when no step of it was flown; whether it was removed."""
        if self._phase is not None:
            return False
        self._states.close()
        self._log.close()
        folder.remove(self.folder, self._made)
        return True

    def __enter__(self) -> "RunRecorder":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close a flight that ended without an outcome."""
        if not self._events.closed:
            reason = f"broken off by {kind.__name__}" if kind else "broken off"
            self.close(Outcome(False, reason, self._now_us, {}, 0.0))

    def _end(self, outcome: Outcome) -> None:
        """Log the end, even when the disk has refused what came before."""
        try:
            self._log.flush()
        finally:
            self._events.outcome(outcome)

    def _lifts_off(self, tick: Tick) -> bool:
        """Whether the load leaves the floor."""
        lifted = float(tick.truth.team.p_WL[2]) - self._rest_m > LIFTED_M
        return tick.phase in (Phase.CARRY, Phase.HOVER) or (tick.phase in PULLING and lifted)

    def _enter(self, phase: Phase, airborne: bool, t_us: TimeUs) -> None:
        """A new phase, or lift-off: what is counted after lift-off starts anew then."""
        if airborne != self._airborne:
            extremes.restart(self._extremes, keep_clearance=True)
        self._phase, self._airborne = phase, airborne
        self._events.phase(t_us, phase, airborne)

    def _add_row(self, tick: Tick) -> None:
        """Write a row; extremes begin anew."""
        row = Row(tick, self._airborne, self._extremes)
        parts = [np.ravel(read(row)) for read in self._quantities]
        np.concatenate(parts, out=self._table[self._count])
        self._count += 1
        extremes.restart(self._extremes, keep_clearance=False)
        if self._count == GROUP_ROWS:
            self._flush()

    def _flush(self) -> None:
        """Write the rows so far; extremes without a case are infinite and become nan."""
        if not self._count:
            return
        table = self._table[: self._count]
        table[np.isinf(table)] = np.nan
        self._states.append(table)
        self._count = 0

    def _reader(self, key: str) -> Callable[["Row"], ArrayLike]:
        """How a block of the layout is read from a row."""
        read, movers = _QUANTITIES[key], self._movers
        if not key.startswith("obstacle"):
            return read
        return lambda row: np.asarray(read(row))[movers]


class Row(NamedTuple):
    """What one row is made of."""

    tick: Tick
    airborne: bool
    extremes: extremes.Extremes


_QUANTITIES: dict[str, Callable[[Row], ArrayLike]] = {
    "t": lambda r: r.tick.truth.stamp_us,
    "phase": lambda r: PHASES.index(r.tick.phase),
    "airborne": lambda r: r.airborne,
    "clearance_min": lambda r: r.extremes.team[extremes.CLEARANCE],
    "vehicle_distance_min": lambda r: r.extremes.team[extremes.DISTANCE],
    "rotor_energy": lambda r: r.extremes.team[extremes.ENERGY],
    "slack": lambda r: r.extremes.team[extremes.SLACK],
    "load": lambda r: r.tick.truth.team.load,
    "ref": lambda r: r.tick.reference,
    "est": lambda r: r.tick.estimate.team.load,
    "wind": lambda r: r.tick.truth.wind_W,
    "vehicle_p": lambda r: r.tick.truth.team.p_WB,
    "vehicle_q": lambda r: r.tick.truth.team.q_WB,
    "vehicle_v": lambda r: r.tick.truth.team.v_WB,
    "vehicle_w": lambda r: r.tick.truth.team.w_WB_B,
    "vehicle_rotor": lambda r: r.tick.truth.rotor_thrust,
    "vehicle_rotor_cmd": lambda r: r.tick.rotor_cmd,
    "vehicle_moment_cmd": lambda r: r.tick.command.moment_B,
    "vehicle_thrust_max": lambda r: r.extremes.thrust_max,
    "vehicle_thrust_cmd": lambda r: r.tick.command.thrust,
    "vehicle_thrust_plan": lambda r: r.tick.planned_thrust,
    "vehicle_alive": lambda r: r.tick.truth.alive,
    "cable_dir": lambda r: r.tick.truth.cables.dir_W,
    "cable_w": lambda r: r.tick.truth.cables.w_W,
    "cable_dir_flat": lambda r: r.tick.flat_cable_dir_W,
    "cable_force_cmd": lambda r: r.tick.command.force_W,
    "cable_force_plan": lambda r: r.tick.planned_force_W,
    "cable_tension": lambda r: r.tick.truth.cables.tension,
    "cable_tension_min": lambda r: r.extremes.tension_min,
    "cable_tension_max": lambda r: r.extremes.tension_max,
    "cable_length": lambda r: r.tick.truth.cables.length,
    "cable_attached": lambda r: r.tick.truth.attached,
    "obstacle_p": lambda r: r.tick.truth.obstacles.p_WO,
    "obstacle_present": lambda r: r.tick.truth.present,
}
"""How each block of the layout is read from a row."""


def _schema(layout: Layout) -> pa.Schema:
    """Columns with their types, and what is needed to read them back."""
    integers = {"t_us": pa.int64()}
    kinds = [integers.get(c, pa.int8() if _is_code(c) else pa.float64()) for c in layout.names]
    about = {"layout": layout.to_json(), "phases": ",".join(p.value for p in PHASES)}
    return pa.schema(list(zip(layout.names, kinds, strict=True)), metadata=about)


def _is_code(name: str) -> bool:
    return name.endswith(("code_nd", "airborne_nd", "alive_nd", "attached_nd", "present_nd"))
