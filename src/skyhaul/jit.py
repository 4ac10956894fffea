# SPDX-License-Identifier: Apache-2.0
"""`numba.njit` with our options, typed for mypy."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def njit(function: F) -> F:
    """Compile a function with numba: cached on disk, releasing the GIL, strict floating point."""
    return cast(F, numba.njit(cache=True, nogil=True)(function))


def njit_ieee(function: F) -> F:
    """As `njit`, but a division by zero gives inf or nan: no branch in the loops over pixels."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def njit_inner(function: F) -> F:
    """For the inside of a hot loop: always inlined, sums in any order, no check of divisors."""
    made = numba.njit(
        cache=True, nogil=True, error_model="numpy", forceinline=True,
        fastmath={"contract", "reassoc"},
    )  # fmt: skip
    return cast(F, made(function))
