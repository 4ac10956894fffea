# SPDX-License-Identifier: Apache-2.0
"""All sensors of a vehicle, of the load and of the team: the same in a flight and after it."""

from dataclasses import dataclass
from typing import Any, Protocol

from skyhaul.plant.api import Truth
from skyhaul.sensors.api import (
    CameraFrame,
    EventReading,
    ImuReading,
    LoadCellReading,
    PayloadReading,
    VehicleReading,
)
from skyhaul.sensors.imu import ImuBank, ImuMemory
from skyhaul.sensors.imu_kernel import Motion
from skyhaul.sensors.load_cell import LoadCell, LoadCellMemory
from skyhaul.sensors.script import FaultScript, ScriptMemory
from skyhaul.sensors.truth_api import EventLabels, SensorTruth

NO_FRAMES: tuple[CameraFrame, ...] = ()


class FrameSource(Protocol):
    """The cameras of one vehicle."""

    def init(self, seed: int) -> Any:  # noqa: ANN401  each kind has its own memory
        """Memory before the first true state."""
        ...

    def step(self, memory: Any, truth: Truth) -> tuple[Any, tuple[CameraFrame, ...]]:  # noqa: ANN401
        """Images that are due now."""
        ...


class EventSource(Protocol):
    """The event camera of one vehicle."""

    def init(self, seed: int) -> Any:  # noqa: ANN401
        """Memory before the first true state."""
        ...

    def step(
        self,
        memory: Any,  # noqa: ANN401
        truth: Truth,
        *,
        last: bool = False,
    ) -> tuple[Any, EventReading | None, EventLabels | None]:
        """Events since the reading before, with their labels; None where none is due.

        With `last` everything up to now is due.

        It takes the memory over and may change it in place: go on with what it returns.
        """
        ...


@dataclass(frozen=True, eq=False)
class VehicleMemory:
    """State of a vehicle's sensors, the IMU apart."""

    cameras: Any
    events: Any
    load_cell: LoadCellMemory | None
    script: ScriptMemory


@dataclass(frozen=True, eq=False)
class VehicleSensors:
    """The sensors of one vehicle, and what befalls them; its IMU is read elsewhere."""

    vehicle: int
    cameras: FrameSource | None
    events: EventSource | None
    load_cell: LoadCell | None
    script: FaultScript

    def init(self, seed: int) -> VehicleMemory:
        """Turn on, before the first true state."""
        return VehicleMemory(
            cameras=self.cameras.init(seed) if self.cameras is not None else None,
            events=self.events.init(seed) if self.events is not None else None,
            load_cell=self.load_cell.init(seed, 1 + self.vehicle) if self.load_cell else None,
            script=self.script.init(seed),
        )

    def step(
        self, memory: VehicleMemory, truth: Truth, imu: ImuReading, *, last: bool = False
    ) -> tuple[VehicleMemory, VehicleReading, EventLabels | None]:
        """Everything that is due at the next true state, faults included."""
        frames, events, labels, cell = NO_FRAMES, None, None, None
        cameras, event_memory, cell_memory = memory.cameras, memory.events, memory.load_cell
        if self.cameras is not None:
            cameras, frames = self.cameras.step(cameras, truth)
        if self.events is not None:
            event_memory, events, labels = self.events.step(event_memory, truth, last=last)
        if self.load_cell is not None and cell_memory is not None:
            cell_memory, cell = self.load_cell.step(cell_memory, truth)
        script, reading, labels = self.script.step(
            memory.script, self._reading(truth, imu, frames, events, cell), labels
        )
        return VehicleMemory(cameras, event_memory, cell_memory, script), reading, labels

    def _reading(
        self,
        truth: Truth,
        imu: ImuReading,
        frames: tuple[CameraFrame, ...],
        events: EventReading | None,
        cell: LoadCellReading | None,
    ) -> VehicleReading:
        return VehicleReading(truth.stamp_us, self.vehicle, imu, frames, events, cell)


@dataclass(frozen=True, eq=False)
class SuiteMemory:
    """State of one vehicle's sensors."""

    imu: ImuMemory
    rest: VehicleMemory


@dataclass(frozen=True, eq=False)
class VehicleSuite:
    """One vehicle alone, as a worker process simulates it after the flight."""

    bank: ImuBank  # of one IMU
    sensors: VehicleSensors

    def init(self, seed: int) -> SuiteMemory:
        """Turn on, before the first true state."""
        return SuiteMemory(self.bank.init(seed), self.sensors.init(seed))

    def step(
        self, memory: SuiteMemory, truth: Truth, *, last: bool = False
    ) -> tuple[SuiteMemory, VehicleReading, SensorTruth]:
        """Advance to the next true state, one step of the plant later; `last`: the last one."""
        imu, (samples,) = self.bank.step(memory.imu, truth.stamp_us, motion_of(truth))
        rest, reading, labels = self.sensors.step(memory.rest, truth, samples, last=last)
        return SuiteMemory(imu, rest), reading, SensorTruth(labels, imu.bias[0])


@dataclass(frozen=True, eq=False)
class PayloadSuite:
    """The load's IMU."""

    bank: ImuBank  # of one IMU
    script: FaultScript

    def init(self, seed: int) -> ImuMemory:
        """Turn on, before the first true state."""
        return self.bank.init(seed)

    def step(self, memory: ImuMemory, truth: Truth) -> tuple[ImuMemory, PayloadReading]:
        """Advance to the next true state, one step of the plant later."""
        memory, (samples,) = self.bank.step(memory, truth.stamp_us, motion_of(truth))
        return memory, PayloadReading(truth.stamp_us, self.script.imu(samples))


@dataclass(frozen=True, eq=False)
class TeamMemory:
    """State of all sensors."""

    imus: ImuMemory
    vehicles: tuple[VehicleMemory, ...]


@dataclass(frozen=True, eq=False)
class TeamSuite:
    """The load and all vehicles, as they are stepped inside a flight: all IMUs in one call.

    Readings are those of `VehicleSuite` and `PayloadSuite`, bit for bit.
    """

    bank: ImuBank  # the load's IMU, then the vehicles'
    vehicles: tuple[VehicleSensors, ...]
    payload_script: FaultScript

    def init(self, seed: int) -> TeamMemory:
        """Turn on, before the first true state."""
        return TeamMemory(self.bank.init(seed), tuple(v.init(seed) for v in self.vehicles))

    def step(
        self, memory: TeamMemory, truth: Truth
    ) -> tuple[TeamMemory, PayloadReading, tuple[VehicleReading, ...]]:
        """Advance to the next true state, one step of the plant later."""
        t_us = truth.stamp_us
        imus, samples = self.bank.step(memory.imus, t_us, motion_of(truth))
        payload = PayloadReading(t_us, self.payload_script.imu(samples[0]))
        memories, readings = [], []
        for i, sensors in enumerate(self.vehicles):
            after, reading, _ = sensors.step(memory.vehicles[i], truth, samples[1 + i])
            memories.append(after)
            readings.append(reading)
        return TeamMemory(imus, tuple(memories)), payload, tuple(readings)


def motion_of(truth: Truth) -> Motion:
    """What IMUs feel of a true state."""
    t = truth.team
    return Motion(t.q_WL, t.v_WL, t.w_WL_L, t.q_WB, t.v_WB, t.w_WB_B)
