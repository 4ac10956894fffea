# SPDX-License-Identifier: Apache-2.0
"""Quadratic programs along a horizon, solved by the HPIPM library that ships with casadi.

The library is called through `ctypes`, so no compiler is needed. Its licence is BSD-2.

Source:
    Frison & Diehl, "HPIPM: a high-performance quadratic programming framework for model
    predictive control", IFAC World Congress 2020.
"""

import ctypes as ct
import functools
import importlib.util
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyhaul.errors import PlatformError
from skyhaul.types import Array

SUCCESS, MAX_ITER, MIN_STEP, NAN_PROBLEM = 0, 1, 2, 9
"""Codes of `QpOutcome.status`; beyond `MIN_STEP` there is no usable iterate."""
_MODE_SPEED = 1


@dataclass(frozen=True)
class QpShape:
    """Sizes of a problem over `stages` intervals. All rows are soft and bounded from below."""

    stages: int
    nx: int  # states of stages 1..stages; the state of stage 0 is given, hence eliminated
    nu: int  # inputs of stages 0..stages-1, with bounds
    ng: int  # rows of stages 1..stages


@dataclass(frozen=True)
class QpOptions:
    """How the interior-point method runs."""

    tolerance: float = 1e-4
    iterations: int = 60
    mu0: float = 100.0
    """First barrier parameter. Between the cost of the states and that of the slacks: among
    obstacles 5 iterations, with 1 it takes 16."""


@dataclass(frozen=True)
class QpOutcome:
    """What one solve gave; the step itself stands in `OcpQp.dx` and `OcpQp.du`."""

    status: int
    iterations: int
    residual: float  # largest of the four KKT residuals, infinity norm


class OcpQp:
    """One problem with its memory: fill the arrays, call `solve`, read `dx` and `du`.

    min sum 1/2 x' Q x + q' x + u' S x + 1/2 u' R u + r' u + sum (1/2 l2 s^2 + l1 s)
    s.t. x_{k+1} = A_k x_k + B_k u_k + b_k,  x_0 = 0,  lower <= u <= upper,
         C_k x_k >= d_k - s_k where active_k,  s_k >= 0

    Matrices are stored transposed (`At[k, j, i]` is A_k[i, j]), as the library reads columns.
    """

    def __init__(self, shape: QpShape, l1: Array, l2: Array, options: QpOptions) -> None:
        n, nx, nu, ng = shape.stages, shape.nx, shape.nu, shape.ng
        self.shape = shape
        self.At, self.Bt = np.zeros((n, nx, nx)), np.zeros((n, nu, nx))
        self.b = np.zeros((n, nx))
        self.Q, self.q = np.zeros((n + 1, nx, nx)), np.zeros((n + 1, nx))
        self.R, self.r = np.zeros((n, nu, nu)), np.zeros((n, nu))
        self.St = np.zeros((n, nx, nu))
        self.lower, self.upper = np.zeros((n, nu)), np.zeros((n, nu))
        self.Ct, self.d = np.zeros((n + 1, nx, ng)), np.zeros((n + 1, ng))
        self.active = np.zeros((n + 1, ng))
        self.dx, self.du = np.zeros((n + 1, nx)), np.zeros((n, nu))
        self._lib = _library()
        self._settings = (l1.copy(), l2.copy(), options)
        self._status, self._iterations = ct.c_int(), ct.c_int()
        self._residual = ct.c_double()
        self._reset()

    def solve(self) -> QpOutcome:
        """Solve with the present arrays, from a cold start, so equal arrays give equal steps."""
        if not all(np.isfinite(a).all() for a in (self.At, self.b, self.q, self.r, self.d)):
            return QpOutcome(NAN_PROBLEM, 0, math.inf)
        lib, ws = self._lib, self._ws
        for set_field, k, address in self._setters:
            set_field(k, address, self._qp)
        lib.d_ocp_qp_ipm_solve(self._qp, self._sol, self._arg, ws)
        lib.d_ocp_qp_ipm_get_status(ws, ct.byref(self._status))
        lib.d_ocp_qp_ipm_get_iter(ws, ct.byref(self._iterations))
        residual = 0.0
        for name in ("stat", "eq", "ineq", "comp"):
            getattr(lib, "d_ocp_qp_ipm_get_max_res_" + name)(ws, ct.byref(self._residual))
            residual = max(residual, self._residual.value)
        for get_field, k, address in self._getters:
            get_field(k, self._sol, address)
        outcome = QpOutcome(self._status.value, self._iterations.value, residual)
        if outcome.status > MIN_STEP:
            self._reset()  # numbers that are none must not stay in the library's memory
        return outcome

    def _reset(self) -> None:
        """Fresh memory in the library."""
        l1, l2, options = self._settings
        self._keep: list[Any] = []
        self._build(options)
        self._constants(l1, l2)
        self._setters = list(self._bind_setters())
        self._getters = list(self._bind_getters())

    def _struct(self, kind: str, *args: Any) -> ct.c_void_p:  # noqa: ANN401
        """Memory for a library structure, created in place."""
        lib = self._lib
        head = self._bytes(getattr(lib, f"d_ocp_qp_{kind}strsize")())
        body = self._bytes(getattr(lib, f"d_ocp_qp_{kind}memsize")(*args))
        getattr(lib, f"d_ocp_qp_{kind}create")(*args, head, body)
        return head

    def _bytes(self, size: int) -> ct.c_void_p:
        buffer = ct.create_string_buffer(int(size) + 64)
        self._keep.append(buffer)
        return ct.cast(buffer, ct.c_void_p)

    def _build(self, options: QpOptions) -> None:
        lib, s = self._lib, self.shape
        self._dim = self._struct("dim_", s.stages)
        for k in range(s.stages + 1):
            first, last = k == 0, k == s.stages
            sizes = {
                "nx": 0 if first else s.nx,
                "nu": 0 if last else s.nu,
                "nbu": 0 if last else s.nu,
                "ng": 0 if first else s.ng,
                "ns": 0 if first else s.ng,
            }
            if not hasattr(lib, "d_ocp_qp_ipm_get_obj"):  # the library of casadi 3.7
                sizes["nsg"] = sizes["ns"]
            for name, value in sizes.items():
                getattr(lib, "d_ocp_qp_dim_set_" + name)(k, value, self._dim)
        self._qp = self._struct("", self._dim)
        self._sol = self._struct("sol_", self._dim)
        self._arg = self._struct("ipm_arg_", self._dim)
        lib.d_ocp_qp_ipm_arg_set_default(_MODE_SPEED, self._arg)
        settings: dict[str, ct.c_int | ct.c_double] = {
            "iter_max": ct.c_int(options.iterations),
            "warm_start": ct.c_int(0),
            "mu0": ct.c_double(options.mu0),
            "var_init_scheme": ct.c_int(1),  # start from the point that obeys the dynamics
        }
        settings |= {
            f"tol_{t}": ct.c_double(options.tolerance) for t in ("stat", "eq", "ineq", "comp")
        }
        for name, c_value in settings.items():
            getattr(lib, "d_ocp_qp_ipm_arg_set_" + name)(ct.byref(c_value), self._arg)
        self._ws = self._struct_ws()

    def _struct_ws(self) -> ct.c_void_p:
        lib = self._lib
        head = self._bytes(lib.d_ocp_qp_ipm_ws_strsize())
        body = self._bytes(lib.d_ocp_qp_ipm_ws_memsize(self._dim, self._arg))
        lib.d_ocp_qp_ipm_ws_create(self._dim, self._arg, head, body)
        return head

    def _constants(self, l1: Array, l2: Array) -> None:
        """Fields that no solve changes: indices, slack weights, masks, zero blocks."""
        s = self.shape
        for k in range(s.stages + 1):
            if k < s.stages:
                self._once("idxbu", k, np.arange(s.nu, dtype=np.int32))
            if k == 0:
                continue
            nbu = s.nu if k < s.stages else 0
            self._once("idxs", k, nbu + np.arange(s.ng, dtype=np.int32))
            zero = np.zeros(s.ng)
            rows = {"zl": l1, "Zl": l2, "zu": zero, "Zu": np.ones(s.ng), "lls": zero, "lus": zero}
            rows |= {"ug": zero, "ug_mask": zero, "lus_mask": zero}
            for name, value in rows.items():
                self._once(name, k, value)
            if k < s.stages:
                self._once("D", k, np.zeros((s.ng, s.nu)))

    def _once(self, name: str, k: int, value: Any) -> None:  # noqa: ANN401
        array = np.ascontiguousarray(value)
        getattr(self._lib, "d_ocp_qp_set_" + name)(k, ct.c_void_p(array.ctypes.data), self._qp)

    def _bind_setters(self) -> Iterator[tuple[Any, int, int]]:
        always = {"b": self.b, "B": self.Bt, "R": self.R, "r": self.r}
        always |= {"lbu": self.lower, "ubu": self.upper}
        later = {"Q": self.Q, "q": self.q, "C": self.Ct, "lg": self.d, "lg_mask": self.active}
        for k in range(self.shape.stages + 1):
            fields = dict(always) if k < self.shape.stages else {}
            if k > 0:
                fields |= later
                if k < self.shape.stages:
                    fields |= {"A": self.At, "S": self.St}
            for name, array in fields.items():
                function = getattr(self._lib, "d_ocp_qp_set_" + name)
                function.argtypes = [ct.c_int, ct.c_void_p, ct.c_void_p]
                yield function, k, array[k].ctypes.data

    def _bind_getters(self) -> Iterator[tuple[Any, int, int]]:
        for name, array in (("u", self.du), ("x", self.dx)):
            function = getattr(self._lib, "d_ocp_qp_sol_get_" + name)
            function.argtypes = [ct.c_int, ct.c_void_p, ct.c_void_p]
            for k in range(int(name == "x"), len(array)):
                yield function, k, array[k].ctypes.data


@functools.cache
def _library() -> Any:  # noqa: ANN401
    """The HPIPM of the casadi wheel.

    Raises:
        PlatformError: when casadi is not installed or brings no HPIPM.
    """
    spec = importlib.util.find_spec("casadi")
    if spec is None or spec.origin is None:
        raise PlatformError("casadi is not installed; `pip install casadi` brings the QP solver")
    folder = Path(spec.origin).parent
    names = {"darwin": "lib{}.dylib", "win32": "lib{}.dll"}
    pattern = names.get(sys.platform, "lib{}.so")
    paths = [folder / pattern.format(name) for name in ("blasfeo", "hpipm")]
    for path in paths:
        if not path.exists():
            raise PlatformError(f"{path} is missing; install casadi >= 3.7 from PyPI")
    ct.CDLL(str(paths[0]), mode=ct.RTLD_GLOBAL)
    lib = ct.CDLL(str(paths[1]))
    for kind in ("dim_", "", "sol_", "ipm_arg_", "ipm_ws_"):
        for what in ("strsize", "memsize"):
            getattr(lib, f"d_ocp_qp_{kind}{what}").restype = ct.c_size_t
    lib.d_ocp_qp_ipm_solve.argtypes = [ct.c_void_p] * 4
    return lib
