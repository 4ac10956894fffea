# SPDX-License-Identifier: Apache-2.0
"""`skyhaul scenarios`: what ships with the package."""

import argparse

from skyhaul.world.load import load_config, scenario_names
from skyhaul.world.scenario import Scenario


def scenarios(_: argparse.Namespace) -> int:
    """Print name and purpose of every scenario that ships."""
    names = scenario_names()
    width = max(len(name) for name in names)
    for name in names:
        print(f"{name:<{width}}  {load_config(Scenario, name).description}")
    return 0
