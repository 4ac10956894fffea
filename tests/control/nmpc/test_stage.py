# SPDX-License-Identifier: Apache-2.0
"""The linearised problem against finite differences of the problem itself."""

import numpy as np
import pytest

from skyhaul.control.api import ControlRequest
from skyhaul.control.nmpc import Nmpc, WrenchNmpc
from skyhaul.control.nmpc.forces import cable_forces, make_scratch
from skyhaul.control.nmpc.handover import starting_point
from skyhaul.control.nmpc.sqp import apply_step
from skyhaul.control.nmpc.stage import Iterate, QpArrays, linearise
from skyhaul.geometry.quaternion import quat_conj, quat_exp, quat_log, quat_mul, quat_to_R
from skyhaul.model import PointPayload, Team, hover_forces
from skyhaul.world.scenario import Limits

ALL = {"four": Team(), "three": Team(count=3), "six": Team(count=6)}
ALL["point"] = Team(payload=PointPayload())
every_team = pytest.mark.parametrize("team", ALL.values(), ids=ALL.keys())


class Case:
    """A random problem and its linearisation."""

    def __init__(self, kind, team, loop, seed=0, lost=None):
        rng = np.random.default_rng(seed)
        active = np.ones(team.count, dtype=bool)
        if lost is not None:
            active[lost] = False
        self.controller = kind().build(team, Limits())
        x0 = np.concatenate([[0.3, 0.1, 2.0, 1.0, 0.0, 0.0, 0.0], 0.3 * rng.normal(size=6)])
        if team.payload.kind == "point":
            x0[10:] = 0.0
        request = ControlRequest(
            stamp_us=500_000,
            load=x0,
            force_W=hover_forces(team) * active[:, None],
            dforce_W=0.1 * rng.normal(size=(team.count, 3)),
            active=active,
            reference=loop.Eight(),
            world_map=None,
        )
        self.model = self.controller.model(tuple(active))
        origin = starting_point(None, request)
        z0, u_now = self.controller._controlled(origin)
        self.problem = self.controller._problem(self.model, request, u_now)
        self.scratch = make_scratch(team.count, len(z0))
        self.rigid, self.rng, self.active = team.payload.kind == "rigid", rng, active
        self.nx = 12 + len(z0)  # what can be moved; j follows the inputs
        self.it = self.disturb(self.controller._first(self.model, self.problem, origin, z0))

    def disturb(self, it):
        nodes, nz = it.z.shape
        dx = 0.1 * self.rng.normal(size=(nodes, 12 + nz))
        dx[:, 12:] *= 0.5 * self.model.im.moves
        if not self.rigid:
            dx[:, 3:6] = dx[:, 9:12] = 0.0
        du = 0.3 * self.rng.normal(size=it.u.shape) * self.model.im.moves
        return self.moved(it, dx, du)

    def moved(self, it, dx, du):
        new = Iterate(it.x.copy(), it.z.copy(), it.u.copy())
        apply_step(new, dx, du)
        return new

    def arrays(self, it):
        qp = self.controller.init().workspace.qp
        arrays = QpArrays(qp.At, qp.Bt, qp.b, qp.Q, qp.q, qp.R, qp.r, qp.St, qp.Ct, qp.d, qp.active)
        p = self.problem
        linearise(p.stage, p.im, p.refs, it, arrays, self.scratch)
        return QpArrays(*(a.copy() for a in arrays))

    def shifted(self, k, d):
        """The iterate with the state of node k moved by d."""
        dx = np.zeros((len(self.it.x), self.nx))
        dx[k] = d
        return self.moved(self.it, dx, np.zeros_like(self.it.u))

    def free(self):
        """Entries of the state that can move at all."""
        fixed = [] if self.rigid else [3, 4, 5, 9, 10, 11]
        moves = [12 + c for c in np.flatnonzero(self.model.im.moves)]
        return [i for i in range(12) if i not in fixed] + moves


def differences(f, columns, size, h=1e-6):
    out = []
    for j in columns:
        d = np.zeros(size)
        d[j] = h
        out.append((f(d) - f(-d)) / (2.0 * h))
    return np.stack(out, axis=-1)


@every_team
def test_dynamics_match_differences_of_the_gap(kind, team, loop):
    case, k = Case(kind, team, loop), 7
    base, nx, free = case.arrays(case.it), case.nx, case.free()
    A = differences(lambda d: case.arrays(case.shifted(k, d)).b[k], free, nx)
    np.testing.assert_allclose(base.At[k].T[:, free], A, atol=3e-5)
    b = base.b[k]
    # the gap falls by the step of the next node, as a rotation vector too
    E = differences(lambda d: case.arrays(case.shifted(k + 1, d)).b[k], free, nx)
    gap = quat_exp(b[3:6])

    def relative(d):
        step = quat_mul(quat_conj(quat_exp(d[3:6])), gap)
        return np.concatenate([b[:3] - d[:3], quat_log(step), b[6:nx] - d[6:], b[nx:]])

    np.testing.assert_allclose(E, differences(relative, free, nx), atol=1e-6)


@every_team
def test_inputs_match_differences_of_the_gap(kind, team, loop):
    case, k = Case(kind, team, loop), 12
    base, nu = case.arrays(case.it), case.it.u.shape[1]

    def gap(d):
        du = np.zeros_like(case.it.u)
        du[k] = d
        return case.arrays(case.moved(case.it, np.zeros((len(case.it.x), 12 + nu)), du)).b[k]

    B = differences(gap, range(nu), nu)
    np.testing.assert_allclose(base.Bt[k].T[: case.nx], B[: case.nx], atol=3e-5)
    np.testing.assert_allclose(base.Bt[k].T[case.nx :], case.model.im.T_F, atol=1e-12)


@every_team
def test_rows_match_differences_of_their_values(kind, team, loop):
    """The thrust rows leave out what the turning of the load adds, so they are left out here."""
    case, k, n = Case(kind, team, loop), 9, team.count
    base, nx, free = case.arrays(case.it), case.nx, case.free()
    rows = [*range(2 * n), 3 * n, 3 * n + 1]
    C = differences(lambda d: -case.arrays(case.shifted(k, d)).d[k], free, nx)
    np.testing.assert_allclose(base.Ct[k].T[rows][:, free], C[rows], atol=2e-5)


def test_thrust_rows_match_differences_by_the_forces_of_a_point_load(loop):
    case, k, n = Case(Nmpc, ALL["point"], loop), 9, 4
    base, nx = case.arrays(case.it), 24
    columns = range(12, 24)
    C = differences(lambda d: -case.arrays(case.shifted(k, d)).d[k], columns, nx)
    np.testing.assert_allclose(base.Ct[k].T[2 * n : 3 * n, 12:24], C[2 * n : 3 * n], atol=1e-5)


@every_team
def test_cost_gradient_matches_differences_of_the_cost(kind, team, loop):
    case, k = Case(kind, team, loop), 5
    base, nx, free = case.arrays(case.it), case.nx, case.free()
    p = case.problem
    weight = 0.5 * (p.stage.dt[k - 1] + p.stage.dt[k])

    def cost(d):
        it, ref = case.shifted(k, d), p.refs
        x, x_ref = it.x[k], ref.x[k]
        relative = quat_mul(quat_conj(x_ref[3:7]), x[3:7])
        e = np.concatenate(
            [
                x[:3] - x_ref[:3],
                quat_log(relative),
                x[7:10] - x_ref[7:10],
                x[10:] - quat_to_R(relative).T @ x_ref[10:],
            ]
        )
        return 0.5 * weight * (p.stage.w_x @ e**2 + p.stage.w_z @ (it.z[k] - ref.z[k]) ** 2)

    gradient = differences(cost, free, nx)
    np.testing.assert_allclose(base.q[k][free], gradient, atol=1e-5 * np.abs(gradient).max())
    # the Gauss-Newton matrix is symmetric and positive
    np.testing.assert_allclose(base.Q[k], base.Q[k].T, atol=1e-12)
    assert np.linalg.eigvalsh(base.Q[k]).min() > 0.0


def test_a_lost_cable_neither_moves_nor_counts(loop):
    case = Case(Nmpc, ALL["four"], loop, lost=2)
    base, n = case.arrays(case.it), 4
    np.testing.assert_array_equal(base.Bt[:, 6:9], 0.0)
    np.testing.assert_array_equal(base.At[:, 18:21, :12], 0.0)
    np.testing.assert_array_equal(base.active[1:, [2, 2 + n, 2 + 2 * n]], 0.0)


@every_team
def test_shares_of_a_wrench_give_it(team):
    """Z = 0: whatever the attitude, the cables together give z = [F; M]."""
    model = WrenchNmpc().build(team, Limits()).model((True,) * team.count)
    mem, rng = make_scratch(team.count, 6), np.random.default_rng(1)
    R = quat_to_R(quat_exp(rng.normal(size=3))) if team.payload.kind == "rigid" else np.eye(3)
    z = np.array([0.3, -0.2, 2.0, 0.02, -0.01, 0.015])
    cable_forces(model.im, R, z, mem)
    np.testing.assert_allclose(mem.f.sum(axis=0), z[:3], atol=1e-12)
    moment = np.cross(team.hooks_L(), mem.f @ R).sum(axis=0)
    wanted = z[3:] if team.payload.kind == "rigid" else np.zeros(3)
    np.testing.assert_allclose(moment, wanted, atol=1e-12)


@pytest.mark.parametrize("k", [0, 4, 11, 17])
def test_cost_of_inputs_matches_differences(kind, k, loop):
    """Rates against the reference's, and bends of the force over all intervals."""
    case = Case(kind, ALL["four"], loop)
    p, nu = case.problem, case.it.u.shape[1]
    base, T = case.arrays(case.it), case.model.im.T_F

    def cost(d):
        u = case.it.u.copy()
        u[k] += d
        total = 0.5 * np.sum(p.stage.dt[:, None] * p.stage.w_u * (u - p.refs.u) ** 2)
        before = np.vstack([p.refs.u_now, u[:-1]])
        gaps = 0.5 * (p.stage.dt + np.append(0.0, p.stage.dt[:-1]))
        bends = (u - before) @ T.T
        return total + 0.5 * p.stage.w_bend * np.sum(bends**2 / gaps[:, None])

    # in the problem the bend after interval k counts through j, the state it hands on
    gradient = base.r[k].copy()
    if k < 17:
        gradient += T.T @ base.q[k + 1][case.nx :]
    np.testing.assert_allclose(
        gradient, differences(cost, range(nu), nu, 1e-5), rtol=1e-4, atol=1e-4
    )
    hessian = base.R[k] + (T.T @ base.Q[k + 1][case.nx :, case.nx :] @ T if k < 17 else 0.0)
    h = 1e-2
    d = case.rng.normal(size=nu)
    curvature = (cost(h * d) - 2.0 * cost(0.0 * d) + cost(-h * d)) / h**2
    assert d @ hessian @ d == pytest.approx(curvature, rel=1e-4)
    if k > 0:
        np.testing.assert_allclose(base.St[k][case.nx :], -base.Q[k][case.nx, case.nx] * T)
