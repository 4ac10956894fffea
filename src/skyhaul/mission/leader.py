# SPDX-License-Identifier: Apache-2.0
"""The leading role: map, plan, solve and order. Every method is one step of Algorithm 1."""

import time
from dataclasses import replace

import numpy as np

from skyhaul.comms.api import Bus
from skyhaul.comms.messages import ORDER, PLAN, Order, PlanMessage, Status
from skyhaul.control.api import ForcePlan
from skyhaul.geometry.quaternion import quat_to_R
from skyhaul.mapping.api import MapChange, WorldMap
from skyhaul.mission.api import LIFTED_M, PULLING, Phase, Recorder, Replan, Trigger
from skyhaul.mission.forces import ForcePlanning
from skyhaul.mission.hearing import SILENT_US
from skyhaul.mission.hindrance import Hindrance, hindrance
from skyhaul.mission.latency import Pending
from skyhaul.mission.loss import reference_after_loss, rest_after_loss
from skyhaul.mission.phases import LeaderView, lifts_level, next_phase, spool_plan
from skyhaul.mission.setup import Stack
from skyhaul.mission.stopwatch import Stopwatch
from skyhaul.mission.take_off import is_clear, predict, without_statics
from skyhaul.mission.triggers import ReplanView, predicted_clearance, replan_cause
from skyhaul.perception.api import ObstacleEstimate, TeamEstimate
from skyhaul.planning.api import Reference, ReferencePlan, ReferenceStatus
from skyhaul.planning.cost import is_better, reference_cost
from skyhaul.planning.heading import HeadingPlan, fan_out
from skyhaul.planning.reference import (
    SplineReference,
    Tilted,
    remaining_time,
    restart_reference,
    resting_reference,
    stop_reference,
    tilts_of,
)
from skyhaul.planning.tasks import LIFT_DT_US, lift_reference, task_reference
from skyhaul.types import (
    LOAD_NX,
    LOAD_P,
    LOAD_V,
    US_PER_S,
    Array,
    Mask,
    TimeUs,
)

_RESTS_MPS, _ARRIVING_US = 0.15, 1_500_000
"""Slower than this the team rests on its way [m/s], but not so soon before the end [us]."""


class Leader:
    """Holds M(t), the reference and the force plan; whichever agent leads runs it."""

    def __init__(
        self, stack: Stack, index: int, bus: Bus, recorder: Recorder, watch: Stopwatch
    ) -> None:
        self.index = index
        self.phase = {"fly-in": Phase.FLY_IN, "air": Phase.CARRY}.get(
            stack.start.kind, Phase.TAUTEN
        )
        self.order: Order | None = None
        self.reference: Reference | None = None
        self._stack, self._bus, self._recorder, self._watch = stack, bus, recorder, watch
        self.forces = ForcePlanning(stack, recorder)
        self._pending: Pending[tuple[Reference, bool, bool]] = Pending(stack.mission.latency)
        self.active: Mask = np.ones(stack.team.count, np.bool_)
        self._map: WorldMap | None = None
        self._change: MapChange | None = None
        self._mapper_memory = stack.mapper.init()
        self._statuses: dict[int, Status] = {}
        self._task_reference: SplineReference | None = None
        self._reaches_goal = False
        self._short: Hindrance | None = None  # why plans end short of the goal
        self._waits = False  # the reference in force rests on its way
        self._any_left = self._enough_left = self._lifts_level = True
        self._heading: HeadingPlan | None = None
        self._last_replan_us = -US_PER_S
        self._phase_since_us = -1
        self._clearance_m = np.inf
        self._floor_z = 0.0
        self._parked = np.zeros((stack.team.count, 3))  # where the way to the stations began
        self._load = np.zeros(LOAD_NX)

    def hear(self, t_us: TimeUs, statuses: list[Status], faulty: frozenset[int]) -> None:
        """Heartbeats since the last cycle, and who can carry no longer."""
        for status in statuses:
            self._statuses[status.vehicle] = status
        active = np.array([i not in faulty for i in range(self._stack.team.count)])
        if np.array_equal(active, self.active):
            return
        self.active = active
        left = ", ".join(str(i) for i in np.flatnonzero(active))
        self._recorder.trigger(Trigger(t_us, "fault", f"vehicles {left} carry on"))
        self.forces.fault(t_us)
        self._any_left = bool(active.any())
        if not self._any_left:
            self._enough_left = False
            return
        rest = rest_after_loss(self._stack.team, tuple(bool(a) for a in active))
        self._enough_left, self._lifts_level = rest.survivable, lifts_level(self._stack, rest)
        if self.reference is not None and rest.survivable and self._stack.arrays.rigid:
            self._tilt(t_us, self.reference, rest.R_WL)

    def _tilt(self, t_us: TimeUs, reference: Reference, R_WL: Array) -> None:
        """Turn the load on its way; a reference of a kind that cannot turn it comes to rest."""
        reaches_goal = self._reaches_goal and isinstance(reference, Tilted)
        turned = reference_after_loss(self._stack, reference, t_us, R_WL)
        self._adopt(t_us, turned, reaches_goal)

    def take_over(
        self, t_us: TimeUs, index: int, order: Order | None, message: PlanMessage | None
    ) -> None:
        """Lead from another vehicle: go on from the order and the plan that it received last."""
        self._recorder.trigger(Trigger(t_us, "leader", f"vehicle {index} follows {self.index}"))
        self.index, self.order = index, None  # it orders by its own name
        if order is not None:
            self.phase, self._phase_since_us = Phase(order.phase), order.since_us
        if message is not None and message.stamp_us < 0:
            message = None  # no leader made it: see `hover_message`
        if message is not None and message.reference is not self.reference:
            self._adopt(t_us, message.reference, self._stack.task.kind != "goto")
        self.forces.follow(message)
        self.forces.new_reference()

    # Step 1: M(t) = SLAM(p(t), o(t)) ------------------------------------------------------------
    def update_map(self, estimate: TeamEstimate, obstacles: ObstacleEstimate) -> None:
        """Bring M(t) up to date and note what changed."""
        self._load = estimate.team.load
        with self._watch.stage("mapping"):
            self._mapper_memory, self._map, self._change = self._stack.mapper.step(
                self._mapper_memory, obstacles, estimate.team
            )
        if self._change.static_changed:
            self._recorder.map(self._map)

    # The phases frame Algorithm 1: it begins and ends in the air ---------------------------------
    def advance(self, t_us: TimeUs, estimate: TeamEstimate) -> None:
        """Move on to the next phase when this one is done, and tell the vehicles."""
        blocked = self._phase_since_us >= 0 and self._column_blocked(t_us, estimate)
        phase = next_phase(self._stack, self._view(t_us, estimate, blocked=blocked))
        if phase is not self.phase or self._phase_since_us < 0:
            self.phase, self._phase_since_us = phase, t_us
            self._enter(t_us, estimate)
        order = Order(t_us, self.phase.value, self.active, blocked, self._phase_since_us)
        if self.order is None or _differs(order, self.order):
            self.order = order
            self._bus.publish(ORDER, self.index, t_us, order)

    def hindrance(self, t_us: TimeUs) -> Hindrance | None:
        """What keeps the mission from going on, and since when, if anything is known of it."""
        if self.phase in (Phase.FLY_IN, Phase.TAUTEN):
            since_us = self._phase_since_us
            silent = [i for i in np.flatnonzero(self.active) if self._heard(t_us, int(i)) is None]
            if silent:
                return Hindrance(f"vehicle {silent[0]} is not heard", since_us)
            waits = self.order is not None and self.order.retreat
            return Hindrance("a mover is in the way of the take-off", since_us) if waits else None
        return None if self._reaches_goal else self._short

    def _view(self, t_us: TimeUs, estimate: TeamEstimate, *, blocked: bool) -> LeaderView:
        return LeaderView(
            phase=self.phase,
            since_s=(t_us - self._phase_since_us) / US_PER_S,
            statuses=tuple(self._heard(t_us, int(i)) for i in np.flatnonzero(self.active)),
            column_blocked=blocked,
            reference_ended=self.reference is not None and t_us >= self.reference.end_us,
            reaches_goal=self._reaches_goal,
            lifted_m=float(estimate.team.p_WL[2]) - self._floor_z,
            enough_left=self._enough_left,
            lifts_level=self._lifts_level,
        )

    def _heard(self, t_us: TimeUs, i: int) -> Status | None:
        """The last heartbeat of a vehicle, unless it has fallen silent."""
        status = self._statuses.get(i)
        return status if status and t_us - status.stamp_us <= SILENT_US else None

    def _column_blocked(self, t_us: TimeUs, estimate: TeamEstimate) -> bool:
        """Whether a mover comes in the way of the take-off before the team can dodge it."""
        if self.phase is not Phase.TAUTEN or self._map is None:
            return False
        left_s = np.full(self._stack.team.count, np.inf)
        for status in self._statuses.values():
            left_s[status.vehicle] = status.station_in_s
        take_off = predict(self._stack, self._parked, estimate.team.load, left_s)
        return not is_clear(self._stack, self._map, t_us, take_off)

    def _enter(self, t_us: TimeUs, estimate: TeamEstimate) -> None:
        """What begins with a phase."""
        stack, load = self._stack, estimate.team.load
        if self.phase is Phase.TAUTEN:
            self._parked = estimate.team.p_WB
        elif self.phase is Phase.LIFT:
            self._floor_z = float(load[2])
            begin = t_us + round(stack.mission.spool_s * US_PER_S)
            lift = lift_reference(load[:3], stack.mission.lift_m, _yaw(load), begin, stack.limits)
            self._adopt(t_us, lift, reaches_goal=False)
            self._publish(t_us, spool_plan(stack, t_us, load, self.active))
        elif self.phase is Phase.SAFE and self.reference is not None:
            self._adopt(t_us, stop_reference(self.reference, t_us, stack.limits), False)
        elif self.phase is Phase.CARRY and self._task_reference is None:
            self._begin_task(t_us, load)

    def _begin_task(self, t_us: TimeUs, load: Array) -> None:
        """The reference of a task that is no journey; a journey begins by planning."""
        stack = self._stack
        if self.reference is None:
            self._adopt(t_us, resting_reference(load[:3], _yaw(load), t_us), reaches_goal=False)
        assert self.reference is not None
        if stack.task.kind == "goto":
            return
        here = self.reference.sample(np.array([t_us]))
        self._task_reference = task_reference(
            stack.task, here.p_WD[0, 0], _yaw(load), t_us, stack.limits
        )
        self._adopt(t_us, self._task_reference, reaches_goal=True)

    # Steps 3 and 4: is there an event e(t)? ----------------------------------------------------
    def detect_event(self, t_us: TimeUs, estimate: TeamEstimate) -> str | None:
        """Why the reference must be planned anew, or None."""
        if self._map is None or self._change is None or self.reference is None:
            return None
        if self._pending.busy:
            return None
        params = self._stack.mission.replan
        self._clearance_m, blocked_in_s = predicted_clearance(
            self._map, self.reference, t_us, params
        )
        if not self._flies(t_us) or self._stack.task.kind != "goto":
            return None
        here = self.reference.sample(np.array([t_us])).p_WD[0, 0]
        view = ReplanView(
            stamp_us=t_us,
            last_replan_us=self._last_replan_us,
            change=self._change,
            clearance_m=self._clearance_m,
            blocked_in_s=blocked_in_s,
            tracking_m=float(np.linalg.norm(estimate.team.p_WL - here)),
            waiting=not self._reaches_goal or self._resting(t_us),
        )
        return replan_cause(params, view)

    def _flies(self, t_us: TimeUs) -> bool:
        """Whether the team can be led elsewhere: from when the load rises straight up."""
        assert self.reference is not None
        rises = self.phase is Phase.LIFT and t_us >= self.reference.start_us + LIFT_DT_US
        return rises or self.phase in (Phase.CARRY, Phase.HOVER)

    def _resting(self, t_us: TimeUs) -> bool:
        """Whether the team rests on its way, for a mover to pass."""
        assert self.reference is not None
        if not self._waits or t_us >= self.reference.end_us - _ARRIVING_US:
            return False
        speed = np.linalg.norm(self.reference.sample(np.array([t_us])).p_WD[0, 1])
        return bool(speed < _RESTS_MPS)

    # Step 2: waypoints = A*(M(t)), path = spline(waypoints) --------------------------------------
    def replan(self, t_us: TimeUs, cause: str) -> None:
        """Ask for a new reference to the goal; take it if it is needed or better."""
        task = self._stack.task
        if self._map is None or self.reference is None or task.kind != "goto":
            return
        began, limits = time.perf_counter(), self._stack.limits
        current = self.reference
        if cause == "tracking_error":
            load = self._load
            tilts = tilts_of(self.reference)  # of a team that lost a vehicle: they stay
            current = replace(
                restart_reference(load[LOAD_P], load[LOAD_V], _yaw(load), t_us, limits), tilts=tilts
            )
        with self._watch.stage("planning"):
            goal = np.array(task.goal_m)
            result = self._stack.planner.plan(self._map, current, t_us, goal, limits)
        wall_ms = 1e3 * (time.perf_counter() - began)
        self._last_replan_us = t_us
        self._mapper_memory = self._stack.mapper.mark_planned(self._mapper_memory)
        self._short = hindrance(self._short, t_us, result)
        chosen = self._choice(result, cause, t_us)
        self._recorder.replan(Replan(t_us, cause, result, chosen is not None, wall_ms))
        if chosen is self.reference:
            self._reaches_goal = result.reaches_goal
        elif chosen is not None:
            self._pending.put(t_us, wall_ms, (chosen, result.reaches_goal, result.waits_us > 0))
            self._recorder.trigger(Trigger(t_us, cause, f"path {result.path.status.value}"))

    def _choice(self, result: ReferencePlan, cause: str, t_us: TimeUs) -> Reference | None:
        """The reference to fly from a plan; None: the one in force stays.

        Without need a route is only changed for one that costs enough less. Where no clear way
        is left, the least bad curve is flown if it keeps farther off than the one in force.
        """
        assert self.reference is not None
        if result.status is not ReferenceStatus.OK:
            better = result.min_clearance_m > self._clearance_m
            return result.best_effort if better else None
        if cause != "better_path":
            return result.reference
        assert result.reference is not None
        better = is_better(
            reference_cost(result.reference, t_us, result.min_clearance_m),
            reference_cost(self.reference, t_us, self._clearance_m),
            remaining_time(self.reference, t_us),
            1.0 - self._stack.mission.replan.better_share,
        )
        return result.reference if result.reaches_goal and better else None

    def _adopt(
        self, t_us: TimeUs, reference: Reference, reaches_goal: bool, waits: bool = False
    ) -> None:
        self.reference, self._reaches_goal, self._waits = reference, reaches_goal, waits
        self._pending.drop()
        self.forces.new_reference()
        before = 0.0 if self._heading is None else self._heading
        azimuths = self._stack.team.azimuths_rad
        self._heading = fan_out(reference, azimuths, t_us, before, self._stack.heading)
        self._recorder.reference(t_us, reference)

    # Step 5: payload NMPC, when triggered -------------------------------------------------------
    def solve_event(self, t_us: TimeUs, estimate: TeamEstimate) -> str | None:
        """Why the force plan must be solved anew, or None."""
        spooling = self.phase is Phase.LIFT and (
            t_us - self._phase_since_us < self._stack.mission.spool_s * US_PER_S
        )
        pulling = self.phase in PULLING
        if self.reference is None or spooling or not pulling or not self._any_left:
            return None
        return self.forces.due(t_us, estimate, self._clearance_m)

    def solve(self, estimate: TeamEstimate, cause: str) -> None:
        """Solve for new cable forces along the reference."""
        assert self.reference is not None
        assert self._map is not None
        stands = float(estimate.team.p_WL[2]) - self._floor_z < LIFTED_M
        free = self.phase is Phase.LIFT and stands  # no pull to the side while the floor holds it
        world_map = without_statics(self._map) if free else self._map
        with self._watch.stage("nmpc"):
            self.forces.solve(cause, estimate, self.reference, world_map, self.active)

    def deliver(self, t_us: TimeUs) -> None:
        """Put what has been computed in force: the reference here, the plan by everybody."""
        planned = self._pending.take(t_us)
        if planned is not None:
            self._adopt(t_us, *planned)
        plan = self.forces.take(t_us)
        if plan is not None:
            self._publish(t_us, plan)

    def _publish(self, t_us: TimeUs, plan: ForcePlan) -> None:
        assert self.reference is not None
        assert self._heading is not None
        message = PlanMessage(t_us, plan, self.reference, self._heading)
        self.forces.follow(message)
        self._bus.publish(PLAN, self.index, t_us, message)


def _differs(a: Order, b: Order) -> bool:
    same = a.phase == b.phase and a.retreat == b.retreat
    return not (same and np.array_equal(a.active, b.active))


def _yaw(load: Array) -> float:
    """Heading of the load [rad]."""
    R_WL = quat_to_R(load[3:7])
    return float(np.arctan2(R_WL[1, 0], R_WL[0, 0]))
