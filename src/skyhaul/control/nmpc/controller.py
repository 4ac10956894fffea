# SPDX-License-Identifier: Apache-2.0
"""The payload NMPC: real-time iterations along the reference, and what to fly when they fail."""

import time
from dataclasses import dataclass, field, replace

import numpy as np

from skyhaul.control.api import ControlRequest, ForcePlan, Solution, SolveStatus
from skyhaul.control.nmpc.allocation import Controlled
from skyhaul.control.nmpc.corridor import STATIC_ROWS
from skyhaul.control.nmpc.forces import InputMap, StageParams, make_scratch
from skyhaul.control.nmpc.handover import Start, starting_point
from skyhaul.control.nmpc.horizon import first_guess, shifted_guess, stage_refs
from skyhaul.control.nmpc.hpipm import OcpQp, QpOptions, QpShape
from skyhaul.control.nmpc.plan import Feedback, force_plan
from skyhaul.control.nmpc.sqp import Problem, SqpResult, Workspace, solve_sqp
from skyhaul.control.nmpc.stage import FIXED_ROWS, NE, NJ, ROWS_PER_CABLE, Iterate
from skyhaul.geometry import kernels
from skyhaul.geometry.quaternion import R_to_quat, quat_to_R
from skyhaul.geometry.so3 import rotation_z
from skyhaul.model.formation import formation, formation_forces, hover_attitude
from skyhaul.model.team import Team
from skyhaul.types import LOAD_P, LOAD_Q, LOAD_W, US_PER_S, Array, Mask, TimeUs

FIRST_ITERATIONS = 10
"""SQP iterations of a solve without an iterate to start from."""


@dataclass(frozen=True, eq=False)
class Settings:
    """A controller's parameters, made ready; forces and their rates in units of hover forces."""

    stage: StageParams
    rate_max: Array  # (nz,) of z [1/s]
    slack: tuple[float, float, float, float]  # weights for forces, tilt, speed, obstacles
    movers: int  # rows for tracks
    small_step: float  # see `Problem.small`
    feedback: Feedback
    qp: QpOptions


@dataclass(frozen=True, eq=False)
class NmpcMemory:
    """What one solve hands to the next."""

    workspace: Workspace  # carries nothing from solve to solve
    stamp_us: TimeUs = 0  # of `iterate`
    iterate: Iterate | None = None
    plan: ForcePlan | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """The team with one set of cables that carry."""

    stage: StageParams
    im: InputMap
    rate_max: Array  # (nz,) [N/s, N m/s]
    hover: Array  # (nz,) [N, N m]
    pinv_L: Array  # (n, 3, 6)


@dataclass(frozen=True, eq=False)
class PayloadNmpc:
    """A `PayloadController`: cable forces that lead the load along its reference."""

    team: Team
    controlled: Controlled
    settings: Settings
    _models: dict[tuple[bool, ...], Model] = field(default_factory=dict, init=False, repr=False)
    """Each model, by the cables that carry, is made once."""

    def init(self) -> NmpcMemory:
        """See `PayloadController`."""
        s, n, nz = self.settings, self.team.count, self.controlled.count(self.team)
        fixed = ROWS_PER_CABLE * n + FIXED_ROWS
        rows = fixed + STATIC_ROWS + s.movers
        slack = np.full(rows, s.slack[0])
        slack[fixed - 2], slack[fixed - 1], slack[fixed:] = s.slack[1:]
        shape = QpShape(stages=len(s.stage.dt), nx=NE + nz + NJ, nu=nz, ng=rows)
        return NmpcMemory(Workspace(OcpQp(shape, slack, slack, s.qp), make_scratch(n, nz)))

    def solve(self, memory: NmpcMemory, request: ControlRequest) -> tuple[NmpcMemory, Solution]:
        """See `PayloadController`."""
        began = time.perf_counter()
        model = self.model(tuple(bool(a) for a in request.active))
        origin = starting_point(memory.plan, request)
        z0, u_now = self._controlled(origin)
        problem = self._problem(model, request, u_now)
        if memory.iterate is None:
            start, count = self._first(model, problem, origin, z0), FIRST_ITERATIONS
        else:
            age_s = (request.stamp_us - memory.stamp_us) / US_PER_S
            refs = (problem.refs, problem.node)
            start = shifted_guess(memory.iterate, age_s, refs, origin.load, z0, model.im.moves)
            count = request.sqp_iterations
        result = solve_sqp(problem, start, count, memory.workspace)
        memory = self._remember(memory, model, result, request, u_now)
        assert memory.plan is not None
        return memory, Solution(
            status=result.status,
            plan=memory.plan,
            kkt_residual=result.residual,
            iterations=result.iterations,
            slack_m=result.slack_m,
            wall_ms=1e3 * (time.perf_counter() - began),
        )

    def model(self, active: tuple[bool, ...]) -> Model:
        """The model for one set of cables that carry."""
        if active not in self._models:
            self._models[active] = _make_model(self, np.array(active))
        return self._models[active]

    def _first(self, model: Model, problem: Problem, origin: Start, z0: Array) -> Iterate:
        """A guess without an iterate to start from."""
        return first_guess(
            self.team,
            self.controlled,
            model.stage,
            (problem.refs, problem.node),
            origin.load,
            (origin.force_W, z0, problem.refs.active > 0.0),
        )

    def _controlled(self, origin: Start) -> tuple[Array, Array]:
        """Z and its rate at the start, (nz,) each."""
        h, q = 1e-3, origin.load[LOAD_Q]
        turned = kernels.quat_mul(q, kernels.quat_exp(h * origin.load[LOAD_W]))
        force = np.stack([origin.force_W, origin.force_W + h * origin.dforce_W])
        z = self.controlled.values(self.team, quat_to_R(np.stack([q, turned])), force)
        return z[0], (z[1] - z[0]) / h

    def _problem(self, model: Model, request: ControlRequest, u_now: Array) -> Problem:
        dt = model.stage.dt
        node = np.append(0.0, np.cumsum(dt))
        t_us = request.stamp_us + US_PER_S * node
        active = request.active
        refs = stage_refs(self.team, self.controlled, request.reference, (t_us, dt), u_now, active)
        return Problem(
            stage=model.stage,
            im=model.im,
            rate_max=model.rate_max,
            hover=model.hover,
            small=self.settings.small_step,
            refs=refs,
            node=node,
            t_us=t_us,
            world_map=request.world_map,
            movers=self.settings.movers,
        )

    def _remember(
        self,
        memory: NmpcMemory,
        model: Model,
        result: SqpResult,
        request: ControlRequest,
        u_now: Array,
    ) -> NmpcMemory:
        """The memory after a solve, with the plan to fly: on failure the last one, then hover."""
        t_us, last = request.stamp_us, memory.plan
        it: Iterate | None = result.iterate
        if result.status is SolveStatus.FAILED:
            same = last is not None and bool(np.array_equal(last.active, request.active))
            if same and last is not None and last.end_us > t_us:
                return replace(memory, iterate=None)
            it, plan_of = None, self._hover(request)
        else:
            plan_of = result.iterate
        plan = force_plan(
            t_us,
            (model.stage, model.im, self.settings.feedback),
            plan_of,
            u_now if it is not None else np.zeros_like(u_now),
            (model.pinv_L, request.active),
            memory.workspace.scratch,
        )
        return replace(memory, stamp_us=t_us, iterate=it, plan=plan)

    def _hover(self, request: ControlRequest) -> Iterate:
        """Rest at the present place, turned only about the vertical, with the forces of hover."""
        R_WL = _hover_rotation(self.team, request)
        weight = self.team.payload.mass_kg * self.team.arrays().g
        wrench_L = np.append(weight * R_WL[2], np.zeros(3))
        force = formation_forces(self.team, wrench_L, request.active) @ R_WL.T
        z = self.controlled.values(self.team, R_WL[None], force[None])
        nodes = len(self.settings.stage.dt) + 1
        x = np.zeros(13)
        x[LOAD_P], x[LOAD_Q] = request.load[LOAD_P], R_to_quat(R_WL)
        return Iterate(
            np.tile(x, (nodes, 1)), np.tile(z, (nodes, 1)), np.zeros((nodes - 1, z.shape[1]))
        )


def _hover_rotation(team: Team, request: ControlRequest) -> Array:
    """Attitude of hover with the present heading, (3, 3)."""
    R_WL = quat_to_R(request.load[LOAD_Q])
    level = hover_attitude(team, request.active)
    if team.payload.kind == "point":
        return level
    # the turn about the vertical that brings the hover attitude closest to the present one
    C = R_WL @ level.T
    return rotation_z(np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1])) @ level


def _make_model(controller: PayloadNmpc, mask: Mask) -> Model:
    """The model for one set of cables that carry, (n,)."""
    s, team = controller.settings, controller.team
    scale = controller.controlled.scale(team, mask)
    stage = s.stage._replace(
        w_z=s.stage.w_z / scale**2,
        w_u=s.stage.w_u / scale**2,
    )
    im = controller.controlled.input_map(team, mask)
    return Model(stage, im, s.rate_max * scale, scale, formation(team, mask).pinv_L)
