# SPDX-License-Identifier: Apache-2.0
"""One vehicle's agent: it follows the leader's order and plan, 500 times a second."""

from typing import NamedTuple

import numpy as np

from skyhaul.comms.api import Bus
from skyhaul.comms.messages import FAULT, STATUS, Fault, Order, PlanMessage, Status
from skyhaul.control.api import VehicleCommand
from skyhaul.control.failure import Rotor
from skyhaul.geometry.kernels import quat_rotate
from skyhaul.mission.api import Phase
from skyhaul.mission.hearing import Hearing
from skyhaul.mission.loss import hover_message, makeshift_plan, plan_in_silence
from skyhaul.mission.phases import spool_share
from skyhaul.mission.setup import Stack
from skyhaul.mission.station import Route, Setpoint, route_along, station_point, way_in
from skyhaul.mission.tracking import SharedTracking
from skyhaul.perception.api import TeamEstimate
from skyhaul.plant.api import PLANT_STEP_US
from skyhaul.types import US_PER_S, Array, Mask, TimeUs

STATUS_PERIOD_US = 20_000
"""Time between two heartbeats of a vehicle [us]."""
_DT_S = PLANT_STEP_US / US_PER_S
_STATION_PHASES = (Phase.FLY_IN.value, Phase.TAUTEN.value)
_RETREAT_PHASES = (Phase.ABORT.value, Phase.DOWN.value)
_LIFT = Phase.LIFT.value


class Makeshift(NamedTuple):
    """What an agent flies by until the leader's next plan."""

    of: PlanMessage  # the leader's last plan
    faulty: frozenset[int]  # who was known to be lost when it was made
    plan: PlanMessage


class Actuation(NamedTuple):
    """What one agent asks of its hardware."""

    command: VehicleCommand  # of one or all vehicles
    row: int  # which of its rows is the agent's own
    release: bool = False  # open the own hook
    attach: bool = False  # close the own hook

    @property
    def rotor_cmd(self) -> Array:
        """Rotor thrusts to ask for, (4,) [N]."""
        rotors: Array = self.command.rotor_cmd[self.row]
        return rotors

    @property
    def thrust(self) -> float:
        """Total thrust asked for [N]."""
        return float(self.command.thrust[self.row])

    @property
    def force_W(self) -> Array:
        """Force of the cable on the load that is aimed at, (3,) [N]."""
        force: Array = self.command.force_W[self.row]
        return force


def command_of(actuations: list[Actuation]) -> VehicleCommand:
    """What all agents ask of their hardware, one row each."""
    first = actuations[0].command
    if all(a.command is first for a in actuations):
        return first
    own = [(a.command, a.row) for a in actuations]
    return VehicleCommand(
        thrust=np.array([c.thrust[i] for c, i in own]),
        moment_B=np.array([c.moment_B[i] for c, i in own]),
        force_W=np.array([c.force_W[i] for c, i in own]),
        dforce_W=np.array([c.dforce_W[i] for c, i in own]),
        rotor_cmd=np.array([c.rotor_cmd[i] for c, i in own]),
    )


class VehicleAgent:
    """Agent of vehicle i. It talks to the others over the bus only."""

    def __init__(self, index: int, stack: Stack, bus: Bus, tracking: SharedTracking) -> None:
        self.index = index
        self.plan = hover_message(stack) if stack.start.kind == "air" else None
        self.order: Order | None = None
        self.faulty: frozenset[int] = frozenset()
        self.chief: int | None = 0  # who leads, by what this vehicle hears
        self._hearing = Hearing(index, stack.team.count)
        self._stack, self._bus = stack, bus
        self._tracking = tracking
        self._watch = stack.fault_watch.init()
        self._makeshift: Makeshift | None = None
        self._route: Route | None = None
        self._creep_m = 0.0
        self._taut_s = 0.0
        self._hooked = False  # its cable has been at the load
        self._attach_s = 0.0  # how long it has tried to hook on
        self._thrust_cmd = 0.0
        arrays = stack.arrays
        ends = [station_point(stack.team, np.zeros(3), np.eye(3), index, s) for s in (0.0, 1.0)]
        self._hook_L, self._cable_L = ends[0], ends[1] - ends[0]
        self._outward = float(stack.team.azimuths_rad[index])
        self._cable_m = float(stack.team.cable_lengths_m()[index])
        self._rotor = Rotor(float(arrays.thrust_max[index]), arrays.motor_lag)

    def hear(self, t_us: TimeUs) -> list[Status]:
        """Take in what the others sent; returns their heartbeats, for whoever leads."""
        statuses: list[Status] = []
        faulty_before = self.faulty
        for envelope in self._bus.receive(self.index, t_us):
            match envelope.payload:
                case PlanMessage() as plan:
                    if plan.stamp_us > _stamp_us(self.plan):
                        self.plan = plan
                case Order() as order:
                    if order.stamp_us > _stamp_us(self.order):
                        self.order = order
                case Fault() as fault:
                    self.faulty |= {fault.vehicle}
                case Status() as status:
                    statuses.append(status)
                    self._hearing.note(t_us, status)
                    if True in status.faulty.tolist():
                        self.faulty |= set(np.flatnonzero(status.faulty).tolist())
        if statuses or self.faulty != faulty_before:
            self._elect(t_us)
        return statuses

    def report(self, t_us: TimeUs, estimate: TeamEstimate) -> Status | None:
        """Send the heartbeat when it is due, and a fault when there is a new one.

        Heartbeats repeat what is known of faults, so that a fault that is lost arrives with the
        next of them, from whichever vehicle knows of it.
        """
        i = self.index
        reason = self._new_fault(t_us, estimate)
        if reason is not None:
            self.faulty |= {i}
            self._route = None
            self._elect(t_us)
            self._bus.publish(FAULT, i, t_us, Fault(t_us, i, reason))
        if t_us % STATUS_PERIOD_US:
            return None
        heard = self._hearing.heard(t_us)
        self._leave_out_the_silent(heard, estimate)
        self._elect(t_us)
        status = Status(
            stamp_us=t_us,
            vehicle=i,
            p_WB=estimate.team.p_WB[i],
            v_WB=estimate.team.v_WB[i],
            tension=float(estimate.cables.tension[i]),
            taut=self._taut_s >= self._stack.mission.station.settle_s,
            attached=bool(estimate.attached[i]),
            at_station=self._arrived(),
            station_in_s=self._station_in_s(),
            on_way_s=0.0 if self._route is None else self._route.progress_s,
            faulty=np.array([j in self.faulty for j in range(self._stack.team.count)]),
            hears=heard,
            order_us=_stamp_us(self.order),
            plan_us=_stamp_us(self.plan),
        )
        self._bus.publish(STATUS, i, t_us, status)
        return status

    def act(self, t_us: TimeUs, estimate: TeamEstimate) -> Actuation:
        """Steps 5 and 6 of Algorithm 1: turn the plan into rotor thrusts."""
        order = self.order
        if self.index in self.faulty:
            act = self._leave(estimate)
        elif order is None:
            act = self._idle() if self.plan is None else self._hold(t_us, estimate, self.plan)
        elif order.phase in _STATION_PHASES:
            act = self._to_station(estimate, retreat=order.retreat)
        elif order.phase in _RETREAT_PHASES:
            act = self._to_station(estimate, retreat=True)
        elif self.plan is not None:
            act = self._carry(estimate, self._plan_now(t_us, self.plan), self._share(t_us, order))
        elif self._route is not None:
            act = self._to_station(estimate, retreat=False)  # the plan is still on its way
        else:
            act = self._idle()
        self._thrust_cmd = sum(act.rotor_cmd.tolist())
        return act

    def _new_fault(self, t_us: TimeUs, estimate: TeamEstimate) -> str | None:
        """Why this vehicle can carry no longer, the first time it is seen; None otherwise."""
        i = self.index
        self._watch, weak = self._stack.fault_watch.step(
            self._watch, self._thrust_cmd, float(estimate.thrust[i]), self._rotor, _DT_S
        )
        attached = bool(estimate.attached[i])
        self._hooked |= attached or self.plan is not None
        if i in self.faulty:
            return None
        if weak:
            return "its rotors do not give the thrust asked for"
        if self._hooked and not attached:
            return "its cable is off the load"
        if self._attach_s > self._stack.mission.station.attach_s:
            return "its hook does not close on the load"
        if self._led_elsewhere(t_us, estimate):
            return "it hears nobody, and the load is led elsewhere"
        return None

    def _elect(self, t_us: TimeUs) -> None:
        self.chief = self._hearing.chief(t_us, self.faulty)

    def _leave_out_the_silent(self, heard: Mask, estimate: TeamEstimate) -> None:
        """A vehicle that is silent and off its cable cannot tell so: it counts as faulty."""
        if self.plan is not None and not heard.all():
            self.faulty |= set(np.flatnonzero(~heard & ~estimate.attached).tolist())

    def _led_elsewhere(self, t_us: TimeUs, estimate: TeamEstimate) -> bool:
        """Whether the load is off this vehicle's reference, and nobody is heard who says why."""
        if self.plan is None or t_us % STATUS_PERIOD_US or not self._hearing.alone(t_us):
            return False
        planned = self.plan.reference.sample(np.array([t_us])).p_WD[0, 0]
        off_m = float(np.linalg.norm(estimate.team.p_WL - planned))
        return off_m > self._stack.mission.replan.tracking_m

    def _plan_now(self, t_us: TimeUs, plan: PlanMessage) -> PlanMessage:
        """The leader's plan, unless it is over or counts on a vehicle known to be faulty."""
        made = self._makeshift
        if made is not None and made.of is plan and made.faulty == self.faulty:
            if t_us > made.plan.plan.end_us:
                made = made._replace(plan=plan_in_silence(self._stack, made.plan, t_us))
        elif self.faulty and any(plan.plan.active[j] for j in self.faulty):
            active = np.array([j not in self.faulty for j in range(self._stack.team.count)])
            made = Makeshift(plan, self.faulty, makeshift_plan(self._stack, plan, t_us, active))
        elif t_us > plan.plan.end_us:
            made = Makeshift(plan, self.faulty, plan_in_silence(self._stack, plan, t_us))
        else:
            return plan
        self._makeshift = made
        return made.plan

    def _share(self, t_us: TimeUs, order: Order) -> float:
        """Share of the planned forces to pull with: all but at the beginning of the lift."""
        if order.phase != _LIFT:
            return 1.0
        return spool_share(self._stack, (t_us - order.since_us) / US_PER_S)

    def _carry(self, estimate: TeamEstimate, message: PlanMessage, share: float) -> Actuation:
        """Follow the force plan with cable and attitude control."""
        i = self.index
        return Actuation(self._tracking.command(i, estimate, message, share), i)

    def _hold(self, t_us: TimeUs, estimate: TeamEstimate, plan: PlanMessage) -> Actuation:
        """Carry on by what it has, without an order: so begins a flight in the air."""
        return self._carry(estimate, self._plan_now(t_us, plan), 1.0)

    def _to_station(self, estimate: TeamEstimate, *, retreat: bool) -> Actuation:
        """Fly to the station over the load and tauten the cable; back again on a retreat."""
        params = self._stack.mission.station
        if self._route is None:
            self._route = route_along(self._way_in(estimate))
        self._route = params.advance(self._route, _DT_S, forwards=not retreat)
        if retreat:
            self._creep_m = self._taut_s = 0.0
            if self._route.progress_s == 0.0:
                return self._idle()
        target, attach = params.setpoint(self._route), False
        if self._arrived():
            target = self._creep(estimate)
            attach = not estimate.attached[self.index]
            self._attach_s = self._attach_s + _DT_S if attach else 0.0
        return self._fly_free(estimate, target, attach=attach)

    def _way_in(self, estimate: TeamEstimate) -> Array:
        """Corners of the way from the parking place to the station, (k, 3) [m]."""
        i, team = self.index, estimate.team
        end = self._station(estimate, 0.0)
        cruise_m = self._stack.mission.station.cruise_height_m
        return way_in(self._stack.start.kind, cruise_m, team.p_WB[i], end)

    def _station(self, estimate: TeamEstimate, creep_m: float) -> Array:
        """Place over the load with the cable a little slack, pushed out by the creep, (3,) [m]."""
        team, share = estimate.team, self._stack.mission.station.slack_share
        out_L = self._hook_L + (share + creep_m / self._cable_m) * self._cable_L
        station: Array = team.p_WL + quat_rotate(team.q_WL, out_L)
        return station

    def _creep(self, estimate: TeamEstimate) -> Setpoint:
        """Push the station outward along the cable until the cable is taut."""
        params, i = self._stack.mission.station, self.index
        slack = estimate.cables.tension[i] < params.taut_n
        self._taut_s = 0.0 if slack else self._taut_s + _DT_S
        if slack and estimate.attached[i]:
            limit = params.creep_max_share * self._stack.team.cable_lengths_m()[i]
            self._creep_m = min(self._creep_m + params.creep_mps * _DT_S, limit)
        return Setpoint(self._station(estimate, self._creep_m), np.zeros(3), np.zeros(3))

    def _leave(self, estimate: TeamEstimate) -> Actuation:
        """Let go of the load, then fly clear of the team if the rotors still turn."""
        i, params = self.index, self._stack.mission.station
        if estimate.attached[i]:
            return self._idle(release=True)
        if self._route is None:
            here = estimate.team.p_WB[i]
            out = here - estimate.team.p_WL
            out[2] = 0.0
            out /= max(float(np.linalg.norm(out)), 1e-9)
            away = here + params.clear_m * out + np.array([0.0, 0.0, 0.3])
            self._route = route_along(np.array([here, away]))
        self._route = params.advance(self._route, _DT_S, forwards=True)
        return self._fly_free(estimate, params.setpoint(self._route))

    def _fly_free(
        self, estimate: TeamEstimate, target: Setpoint, *, attach: bool = False
    ) -> Actuation:
        rotors, thrust, moment = self._stack.free_flight.step_one(
            estimate.team, self.index, np.array(target), self._outward
        )
        return Actuation(_one_row(rotors, thrust, moment), 0, attach=attach)

    def _idle(self, *, release: bool = False) -> Actuation:
        return Actuation(_one_row(np.zeros(4), 0.0, np.zeros(3)), 0, release=release)

    def _station_in_s(self) -> float:
        """Time until the station is reached [s]; inf while parked."""
        if self._route is None or self._route.progress_s == 0.0:
            return np.inf
        return self._stack.mission.station.duration_s(self._route) - self._route.progress_s

    def _arrived(self) -> bool:
        route = self._route
        return route is not None and self._stack.mission.station.arrived(route)


def _one_row(rotors: Array, thrust: float, moment: Array) -> VehicleCommand:
    """The command of one vehicle that aims at no cable force."""
    nothing = np.zeros((1, 3))
    return VehicleCommand(np.array([thrust]), moment[None], nothing, nothing, rotors[None])


def _stamp_us(message: Order | PlanMessage | None) -> TimeUs:
    """Stamp of a message that a vehicle has; -1 while it has none."""
    return -1 if message is None else message.stamp_us
