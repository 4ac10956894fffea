# SPDX-License-Identifier: Apache-2.0
"""The cache of compiled code follows edits in files that the kernel's own file imports."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from skyhaul.jit import sources_digest

CALL = """
import sys
from pkg.caller import call
print(call(1.0), sum(call.stats.cache_hits.values()))
"""
CALLER = """
from skyhaul.jit import njit
from pkg.deep import (
    middle,
)

@njit
def call(x):
    return middle.double(x)
"""
MIDDLE = """
from skyhaul.jit import njit
from pkg.constants import FACTOR

@njit
def double(x):
    return FACTOR * x
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Caller, callee in a subpackage, and a constant in a third file."""
    files = {"caller": CALLER, "deep/middle": MIDDLE, "constants": "FACTOR = 2.0\n"}
    for name in ("__init__", "deep/__init__", "unrelated"):
        files[name] = ""
    for name, text in files.items():
        path = tmp_path / "pkg" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "pkg"


def answer(package: Path) -> tuple[float, int]:
    """What the kernel gives in a new process, and whether it came from the cache."""
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(package.parent), *sys.path])}
    command = [sys.executable, "-c", CALL]
    run = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    value, hits = run.stdout.split()
    return float(value), int(hits)


def test_an_edit_of_a_callee_or_its_constant_is_followed(package: Path) -> None:
    assert answer(package) == (2.0, 0)
    assert answer(package) == (2.0, 1)
    (package / "constants.py").write_text("FACTOR = 3.0\n")
    assert answer(package) == (3.0, 0)
    middle = package / "deep" / "middle.py"
    middle.write_text(MIDDLE.replace("* x", "* x + 1.0"))
    assert answer(package) == (4.0, 0)
    (package / "unrelated.py").write_text("X = 1\n")
    assert answer(package) == (4.0, 1)


def test_modules_with_other_imports_have_other_digests() -> None:
    assert sources_digest("skyhaul.types") != sources_digest("skyhaul.geometry.kernels")
    assert len(sources_digest("skyhaul.types")) == 64
