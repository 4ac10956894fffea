# SPDX-License-Identifier: Apache-2.0
"""What the flags of a command change in the configuration."""

import argparse

from skyhaul.errors import ConfigError


def overrides_of(args: argparse.Namespace) -> list[str]:
    """The entries of --set, in order."""
    return [entry for group in args.overrides for entry in group]


def run_overrides(args: argparse.Namespace) -> list[str]:
    """Entries of `skyhaul run`: its own flags, then --set, which wins.

    Raises:
        ConfigError: For `--perception full`: obstacles are not seen inside a flight yet.
    """
    if args.perception == "full":
        raise ConfigError(
            "--perception full: obstacles are not seen by cameras inside a flight yet; fly with "
            "--perception truth, or on own odometry with --set perception.team.kind=fused "
            "perception.odometry.kind=ekf"
        )
    flags = []
    if args.trigger is not None:
        flags.append(f"mission.trigger.kind={args.trigger}")
    if args.latency != "none":
        flags.append(f"mission.latency={args.latency}")
    return flags + overrides_of(args)
