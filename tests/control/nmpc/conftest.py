# SPDX-License-Identifier: Apache-2.0
"""Stand-ins and the closed loop of a load under ideal cables, shared with the benchmark."""

import importlib.util
import sys
from pathlib import Path

import pytest

from skyhaul.control.nmpc import Nmpc, WrenchNmpc
from skyhaul.world.scenario import Limits

LOOP = Path(__file__).parents[3] / "benchmarks" / "load_loop.py"


def load_module(path):
    spec = importlib.util.spec_from_file_location("load_loop", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def loop():
    """The module `benchmarks/load_loop.py`."""
    return sys.modules.get("load_loop") or load_module(LOOP)


@pytest.fixture(params=[Nmpc, WrenchNmpc], ids=["nmpc", "wrench"])
def kind(request):
    """Both kinds of controller."""
    return request.param


@pytest.fixture
def limits():
    return Limits()
