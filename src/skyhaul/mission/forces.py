# SPDX-License-Identifier: Apache-2.0
"""Step 5 of Algorithm 1: the force plan, when to solve it anew, and from where."""

import numpy as np

from skyhaul.comms.messages import PlanMessage
from skyhaul.control.api import ControlRequest, ForcePlan, Solution, SolveStatus
from skyhaul.control.force_plan import (
    PLANNED_NX,
    PlanArrays,
    PlanSample,
    load_error,
    plan_arrays,
    sample_arrays,
    sample_motion,
)
from skyhaul.control.geometric import GeometricController
from skyhaul.geometry.quaternion import quat_exp, quat_mul, quat_to_R
from skyhaul.mapping.api import WorldMap
from skyhaul.mission.api import Recorder, Solve, Trigger
from skyhaul.mission.latency import Pending
from skyhaul.mission.phases import without_feedback
from skyhaul.mission.setup import Stack
from skyhaul.mission.triggers import SolveView
from skyhaul.perception.api import TeamEstimate
from skyhaul.planning.api import Reference
from skyhaul.types import (
    ERR_P,
    ERR_R,
    ERR_V,
    ERR_W,
    LOAD_NE,
    LOAD_P,
    LOAD_Q,
    LOAD_V,
    LOAD_W,
    US_PER_S,
    Array,
    Mask,
    TimeUs,
)

LOOK_PERIOD_US = 10_000
"""The load is held against its plan this often; other causes are looked for at every tick [us]."""


FAILURES_MAX = 3
"""After so many failed solves in a row the geometric law flies, for `recovery_s`; each time that
the first solve after it fails as well, for twice as long, up to `BACK_OFF_MAX` times."""
BACK_OFF_MAX = 8


class ForcePlanning:
    """Keeps the force plan in force and solves for the next one.

    While solves fail, the last plan is flown on, then the controller's safe hover; after
    `FAILURES_MAX` of them, plans come from the geometric law, and the solver is tried now and then.
    """

    def __init__(self, stack: Stack, recorder: Recorder) -> None:
        self.message: PlanMessage | None = None
        self._stack, self._recorder = stack, recorder
        self._memory = stack.controller.init()
        self._arrays: PlanArrays | None = None
        self._pending: Pending[ForcePlan] = Pending(stack.mission.latency)
        self._recover_until_us = 0
        self._tried_us = -US_PER_S  # when the last solve was tried
        self._failures = self._rounds = 0  # solves that failed in a row, and pauses after them
        self._reference_changed = self._fault = self._failed = False

    def new_reference(self) -> None:
        """The reference has changed: solve soon."""
        self._reference_changed = True

    def fault(self, t_us: TimeUs) -> None:
        """Other cables carry from now on: start afresh, by the geometric law for a while."""
        self._fault = True
        self._recover(t_us, 1)

    def _recover(self, t_us: TimeUs, times: int) -> None:
        """Fly by the geometric law for a while; the controller starts afresh after it."""
        self._memory = self._stack.controller.init()
        pause_us = round(self._stack.mission.recovery_s * US_PER_S)
        self._recover_until_us = max(self._recover_until_us, t_us + times * pause_us)

    def follow(self, message: PlanMessage | None) -> None:
        """Put a plan in force."""
        self.message = message
        self._arrays = None if message is None else plan_arrays(message.plan)

    def due(self, t_us: TimeUs, estimate: TeamEstimate, clearance_m: float) -> str | None:
        """Why the plan must be solved anew, or None; `clearance_m` is the least one ahead."""
        if self._pending.busy:
            return None
        if self.message is None:
            return "start"
        plan, look = self.message.plan, t_us % LOOK_PERIOD_US == 0
        view = SolveView(
            since_s=(t_us - self._tried_us) / US_PER_S,
            age_s=(t_us - plan.stamp_us) / US_PER_S,
            plan_s=float(plan.node_s[-1]),
            error=self._error(t_us, estimate.team.load) if look else None,
            clearance_m=clearance_m,
            reference_changed=self._reference_changed,
            fault=self._fault,
            failed=self._failed,
        )
        return self._stack.mission.trigger.cause(view)

    def solve(
        self,
        cause: str,
        estimate: TeamEstimate,
        reference: Reference,
        world_map: WorldMap,
        active: Mask,
    ) -> None:
        """Solve for new cable forces along a reference; `take` gives the plan when it is due."""
        trigger, t_us = self._stack.mission.trigger, estimate.stamp_us
        load, force, dforce = self._initial(estimate)
        request = ControlRequest(
            stamp_us=t_us,
            load=load,
            force_W=force,
            dforce_W=dforce,
            active=active,
            reference=reference,
            world_map=world_map,
            sqp_iterations=trigger.sqp_iterations,
        )
        solution = self._solve(request)
        self._reference_changed = self._fault = False
        self._failed, self._tried_us = solution.status is SolveStatus.FAILED, t_us
        self._recorder.trigger(Trigger(t_us, cause, solution.status.value))
        self._recorder.solve(Solve(t_us, cause, solution))
        bare = not trigger.feedback and not self._by_law(t_us)
        plan = without_feedback(solution.plan) if bare else solution.plan
        self._pending.put(t_us, solution.wall_ms, plan)

    def planned(self, t_us: TimeUs) -> PlanSample | None:
        """The plan in force at a time, for the record."""
        if self.message is None or self._arrays is None:
            return None
        return sample_arrays(self._arrays, 1e-6 * (t_us - self.message.plan.stamp_us))

    def take(self, t_us: TimeUs) -> ForcePlan | None:
        """The plan that takes effect now, if one does."""
        return self._pending.take(t_us)

    def _solve(self, request: ControlRequest) -> Solution:
        if self._recovering(request.stamp_us):
            _, solution = self._stack.backup.solve(None, request)
            return solution
        self._memory, solution = self._stack.controller.solve(self._memory, request)
        if solution.status is not SolveStatus.FAILED:
            self._failures = self._rounds = 0
            return solution
        self._failures += 1
        if self._failures >= FAILURES_MAX:
            self._recover(request.stamp_us, min(2**self._rounds, BACK_OFF_MAX))
            self._failures, self._rounds = FAILURES_MAX - 1, self._rounds + 1
        return solution

    def _recovering(self, t_us: TimeUs) -> bool:
        """Whether a vehicle was lost a moment ago."""
        return t_us < self._recover_until_us

    def _by_law(self, t_us: TimeUs) -> bool:
        """Whether plans come from the geometric law, which is nothing but its feedback."""
        return self._recovering(t_us) or isinstance(self._stack.controller, GeometricController)

    def _error(self, t_us: TimeUs, load: Array) -> Array:
        """Measured load against the planned one, (12,)."""
        planned, error = np.empty(PLANNED_NX), np.empty(LOAD_NE)
        assert self._arrays is not None
        assert self.message is not None
        sample_motion(self._arrays, (t_us - self.message.plan.stamp_us) / US_PER_S, planned)
        load_error(load, planned, error)
        return error

    def _initial(self, estimate: TeamEstimate) -> tuple[Array, Array, Array]:
        """Load state, cable forces and their rates from which a solve starts.

        The new plan goes on from the old one, and the feedback keeps the load in a tube around
        both; where the load has left the tube, the plan is moved after it, to the tube's edge.
        Without feedback every solve starts from what is measured. The commanded forces go on
        without a jump either way.

        Source: Mayne, Seron, Rakovic, "Robust model predictive control of constrained linear
            systems with bounded disturbances", Automatica 41 (2005).
        """
        cables, trigger = estimate.cables, self._stack.mission.trigger
        if self.message is None:
            pull = -cables.tension[:, None] * cables.dir_W
            return estimate.team.load, pull, np.zeros_like(pull)
        now = self.planned(estimate.stamp_us)
        assert now is not None
        error = self._error(estimate.stamp_us, estimate.team.load)
        outside = 1.0
        if trigger.feedback:
            outside -= 1.0 / max(1.0, trigger.tube.measure(error))
        if outside == 0.0:
            return now.load, now.force_W, now.dforce_W
        load = move_load(now.load, outside * error)
        return load, now.force_W + now.gain @ (outside * error), now.dforce_W


def move_load(load: Array, error: Array) -> Array:
    """The load state that differs by an error, (12,), from another, (13,)."""
    moved = load.copy()
    moved[LOAD_P] += error[ERR_P]
    turn = quat_exp(error[ERR_R])
    moved[LOAD_Q] = quat_mul(load[LOAD_Q], turn)
    moved[LOAD_V] += error[ERR_V]
    moved[LOAD_W] = error[ERR_W] + quat_to_R(turn).T @ load[LOAD_W]
    return moved
