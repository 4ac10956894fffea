# SPDX-License-Identifier: Apache-2.0
"""Random teams and states, and an independent model in maximal coordinates."""

from types import SimpleNamespace

import numpy as np
import pytest

from skyhaul.geometry.quaternion import quat_mul, quat_normalize, quat_rotate, quat_to_R
from skyhaul.model import PointPayload, RigidPayload, TautState, Team
from skyhaul.model.team import VehicleOverride


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _team(rng, n, kind):
    """A team without any symmetry: hooks, masses and cables all differ."""
    overrides = tuple(
        VehicleOverride(
            index=i, mass_kg=rng.uniform(0.2, 0.5), cable_length_m=rng.uniform(0.8, 1.5)
        )
        for i in range(n)
    )
    if kind == "point":
        return Team(count=n, overrides=overrides, payload=PointPayload(mass_kg=0.3))
    ring = 2 * np.pi * (np.arange(n) + rng.uniform(-0.2, 0.2, n)) / n
    hooks = np.column_stack([0.2 * np.cos(ring), 0.15 * np.sin(ring), rng.uniform(0.02, 0.06, n)])
    payload = RigidPayload(mass_kg=0.3, inertia_kgm2=(1.0e-3, 1.6e-3, 2.2e-3))
    return Team(
        count=n,
        overrides=overrides,
        payload=payload,
        azimuths_deg=tuple(np.degrees(ring)),
        hooks_m=tuple(map(tuple, hooks)),
        separation_m=0.4,
    )


def _state(rng, n, kind, w_L=3.0, cable_w=2.0, body_w=6.0):
    """A state with load, cable and body rates of the given lengths."""
    turns = kind == "rigid"
    cable_dir = _unit(np.array([0, 0, -1.0]) + 0.4 * rng.normal(size=(n, 3)))
    return TautState(
        p_WL=rng.normal(size=3),
        q_WL=quat_normalize(rng.normal(size=4)) if turns else np.array([1.0, 0, 0, 0]),
        v_WL=rng.normal(size=3),
        w_WL_L=w_L * _unit(rng.normal(size=3)) if turns else np.zeros(3),
        cable_dir_W=cable_dir,
        cable_w_W=cable_w * _unit(np.cross(cable_dir, rng.normal(size=(n, 3)))),
        q_WB=quat_normalize(rng.normal(size=(n, 4))),
        w_WB_B=body_w * _unit(rng.normal(size=(n, 3))),
    )


def _wrenches(rng, n):
    moments = rng.uniform(-1, 1, size=(n, 3)) * [0.1, 0.1, 0.02]
    return np.column_stack([rng.uniform(0.2, 4.24, n), moments])


def _maximal_rates(team, state, wrenches):
    """Accelerations from the constraints |p_A - p_B| = l, bodies free, world axes.

    [M -G^T; G 0] (accelerations, tensions per metre) = (forces, -centripetal terms)
    """
    a, n = team.arrays(), state.n
    dim = 6 if a.rigid else 3
    R = quat_to_R(state.q_WL)
    r, w = quat_rotate(state.q_WL, a.p_LA) * a.rigid, quat_rotate(state.q_WL, state.w_WL_L)
    J = R @ np.diag(a.J_L) @ R.T
    M, G = np.zeros((dim + 3 * n, dim + 3 * n)), np.zeros((n, dim + 3 * n))
    F, c = np.zeros(dim + 3 * n), np.zeros(n)
    M[:3, :3], F[2] = a.m_L * np.eye(3), -a.m_L * a.g
    M[3:dim, 3:dim], F[3:dim] = J[: dim - 3, : dim - 3], -np.cross(w, J @ w)[: dim - 3]
    for i in range(n):
        k = slice(dim + 3 * i, dim + 3 * i + 3)
        d = state.p_WL + quat_rotate(state.q_WL, a.p_LA[i]) - state.p_WB[i]
        dd = state.v_WL + np.cross(w, r[i]) - state.v_WB[i]
        M[k, k] = a.m_B[i] * np.eye(3)
        F[k] = wrenches[i, 0] * quat_to_R(state.q_WB[i])[:, 2] - [0, 0, a.m_B[i] * a.g]
        G[i, :3], G[i, 3:dim], G[i, k] = d, np.cross(r[i], d)[: dim - 3], -d
        c[i] = -dd @ dd - d @ np.cross(w, np.cross(w, r[i]))
    kkt = np.block([[M, G.T], [G, np.zeros((n, n))]])
    solution = np.linalg.solve(kkt, np.concatenate([F, c]))
    dw_W = np.append(solution[3:dim], np.zeros(6 - dim))
    gyro = np.cross(state.w_WB_B, a.J_B * state.w_WB_B)
    return SimpleNamespace(
        a_WL=solution[:3],
        dw_WL_L=R.T @ dw_W,
        a_WB=solution[dim : dim + 3 * n].reshape(n, 3),
        dw_WB_B=(wrenches[:, 1:] - gyro) / a.J_B,
        tension=solution[dim + 3 * n :] * a.length,
        dq_WL=0.5 * quat_mul(state.q_WL, np.append(0.0, state.w_WL_L)) * a.rigid,
        dq_WB=0.5 * quat_mul(state.q_WB, np.column_stack([np.zeros(n), state.w_WB_B])),
    )


@pytest.fixture
def make():
    """Makers of random teams, states and wrenches; the independent model."""
    return SimpleNamespace(
        team=_team, state=_state, wrenches=_wrenches, maximal_rates=_maximal_rates
    )
