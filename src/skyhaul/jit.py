# SPDX-License-Identifier: Apache-2.0
"""`numba.njit` with our options, typed for mypy, and a cache that follows edits in every file.

numba's cache on disk looks at the file of a function only; but compiled into the function are the
functions it calls and the constants of other files. Here the cache also holds the digest of
every file of the package that the function's module imports, directly or not.
"""

import hashlib
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., object])

_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([\w.]+))", re.M
)


def njit(function: F) -> F:
    """Compile a function with numba: cached on disk, releasing the GIL, strict floating point."""
    return cast(F, _following_sources(numba.njit(cache=True, nogil=True)(function)))


def njit_ieee(function: F) -> F:
    """As `njit`, but a division by zero gives inf or nan: no branch in the loops over pixels."""
    compiled = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    return cast(F, _following_sources(compiled))


def njit_inner(function: F) -> F:
    """For the inside of a hot loop: always inlined, sums in any order, no check of divisors."""
    compiled = numba.njit(
        cache=True, nogil=True, error_model="numpy", forceinline=True,
        fastmath={"contract", "reassoc"},
    )(function)  # fmt: skip
    return cast(F, _following_sources(compiled))


def _following_sources(dispatcher: Any) -> Any:  # noqa: ANN401  numba has no types
    """Make the digest of the sources a part of the cache's version, which is looked at first."""
    file = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
    if file is not None:  # there is none where numba is told not to compile
        file._version = f"{file._version} {sources_digest(dispatcher.py_func.__module__)}"
    return dispatcher


@cache
def sources_digest(module: str) -> str:
    """Digest of a module's source and of all that it imports from its own package."""
    package, found, todo = module.partition(".")[0], set[str](), [module]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += _source(package, name)[1]
    whole = "".join(_source(package, name)[0] for name in sorted(found))
    return hashlib.sha256(whole.encode()).hexdigest()


@cache
def _source(package: str, module: str) -> tuple[str, list[str]]:
    """Digest of one module's source, and what it imports from the package; empty if not there."""
    folders = getattr(sys.modules.get(package), "__path__", ())
    if not folders:
        return "", []  # a script
    path = Path(folders[0]).joinpath(*module.split(".")[1:])
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    if not path.is_file():
        return "", []
    text = path.read_text("utf-8")
    imports = []
    for origin, names, whole in _IMPORT.findall(text):
        if (origin or whole).partition(".")[0] == package:
            imports.append(origin or whole)
            imports += [f"{origin}.{name}" for name in re.findall(r"\w+", names)]
    return hashlib.sha256(text.encode()).hexdigest(), imports


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
