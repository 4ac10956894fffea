# SPDX-License-Identifier: Apache-2.0
"""What the payload controller decides: every cable force, or the wrench that the cables share."""

from typing import Protocol

import numpy as np

from skyhaul.control.nmpc.forces import InputMap
from skyhaul.control.nmpc.load_step import N_MOMENT
from skyhaul.geometry.so3 import hat
from skyhaul.model.formation import formation
from skyhaul.model.team import Team
from skyhaul.types import Array, Mask


class Controlled(Protocol):
    """The controlled forces z of a controller. Pure."""

    def count(self, team: Team) -> int:
        """Entries of z."""
        ...

    def input_map(self, team: Team, active: Mask) -> InputMap:
        """How z acts on the load and through the cables that carry."""
        ...

    def scale(self, team: Team, active: Mask) -> Array:
        """Size of each entry of z in hover, (nz,) [N, N m]: the unit of weights and bounds."""
        ...

    def values(self, team: Team, R_WL: Array, force_W: Array) -> Array:
        """Z of cable forces on the load: (k, 3, 3), (k, n, 3) -> (k, nz)."""
        ...


class FreeForces:
    """Z holds the force vectors of all cables, W axes."""

    def count(self, team: Team) -> int:
        """See `Controlled`."""
        return 3 * team.count

    def input_map(self, team: Team, active: Mask) -> InputMap:
        """See `Controlled`."""
        n, p_LA = team.count, team.hooks_L()
        nz = 3 * n
        T_F, T_y = np.zeros((3, nz)), np.zeros((N_MOMENT, nz))
        for i in np.flatnonzero(active):
            for c in range(3):
                T_F[c, 3 * i + c] = 1.0
                T_y[3 * c : 3 * c + 3, 3 * i + c] = p_LA[i]
        return InputMap(
            T_F=T_F,
            T_y=T_y,
            Z=np.eye(nz),
            L=np.zeros((nz, 6)),
            f_L=np.zeros(nz),
            shares=False,
            moves=np.repeat(active.astype(np.float64), 3),
        )

    def scale(self, team: Team, active: Mask) -> Array:
        """See `Controlled`."""
        weight = team.payload.mass_kg * team.arrays().g
        return np.full(3 * team.count, weight / max(1, int(np.sum(active))))

    def values(self, team: Team, R_WL: Array, force_W: Array) -> Array:
        """See `Controlled`."""
        return force_W.reshape(len(force_W), -1)


class WrenchShares:
    """Z holds the wrench on the load: F in W axes, M in L axes; the cables share it by P^+.

    Source:    Paper eqs. (19) and (26): U = [F, M], mu = diag(R_L) P^+ [R_L^T F; M].
    Deviation: Internal forces lean the cables outward (PAPER_NOTES 16), and the rate of U is the
        decision, not U: a held U would ask the cables to jump at every step.
    """

    def count(self, team: Team) -> int:
        """See `Controlled`."""
        return 6

    def input_map(self, team: Team, active: Mask) -> InputMap:
        """See `Controlled`."""
        form = formation(team, active)
        T_F, T_y = np.zeros((3, 6)), np.zeros((N_MOMENT, 6))
        T_F[:, :3] = np.eye(3)
        T_y[9:, 3:] = np.eye(3)
        return InputMap(
            T_F=T_F,
            T_y=T_y,
            Z=np.zeros((3 * team.count, 6)),
            L=np.ascontiguousarray(form.pinv_L.reshape(-1, 6)),
            f_L=np.ascontiguousarray(form.internal_L.ravel()),
            shares=True,
            moves=np.ones(6),
        )

    def scale(self, team: Team, active: Mask) -> Array:
        """See `Controlled`."""
        weight = team.payload.mass_kg * team.arrays().g
        lever = max(0.05, float(np.max(np.linalg.norm(team.hooks_L(), axis=1))))
        return np.repeat([weight, 0.5 * weight * lever], 3)

    def values(self, team: Team, R_WL: Array, force_W: Array) -> Array:
        """See `Controlled`."""
        force_L = np.einsum("kba,knb->kna", R_WL, force_W)
        moment = np.einsum("nab,knb->ka", hat(team.hooks_L()), force_L)
        return np.concatenate([force_W.sum(axis=1), moment], axis=1)
