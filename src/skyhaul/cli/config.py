# SPDX-License-Identifier: Apache-2.0
"""`skyhaul config`: everything that decides a flight, but for the seed."""

import argparse

from skyhaul.cli.overrides import overrides_of
from skyhaul.mission.config import RunConfig
from skyhaul.world.load import dump_config, load_config


def config(args: argparse.Namespace) -> int:
    """Print the resolved configuration of a scenario as YAML that can be flown."""
    print(dump_config(load_config(RunConfig, args.scenario, overrides_of(args))), end="")
    return 0
