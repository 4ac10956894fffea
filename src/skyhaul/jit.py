# SPDX-License-Identifier: Apache-2.0
"""`numba.njit` with our options, typed for mypy."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar, cast

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., object])


def njit(function: F) -> F:
    """Compile a function with numba: cached on disk, releasing the GIL, strict floating point."""
    return cast(F, numba.njit(cache=True, nogil=True)(function))


def njit_ieee(function: F) -> F:
    """As `njit`, but a division by zero gives inf or nan: no branch in the loops over pixels."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


@contextmanager
def told_of_compiling(tell: Callable[[str], None]) -> Iterator[None]:
    """Inside, `tell` is called with the name of each function that is compiled, and not cached."""
    with event.install_listener("numba:compile", _Teller(tell)):
        yield


class _Teller(event.Listener):
    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    def on_start(self, event: event.Event) -> None:
        self._tell(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event: event.Event) -> None:
        pass
