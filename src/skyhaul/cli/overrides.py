# SPDX-License-Identifier: Apache-2.0
"""What the flags of a command change in the configuration."""

import argparse

from skyhaul.errors import ConfigError


def overrides_of(args: argparse.Namespace) -> list[str]:
    """The entries of --set, in order."""
    return list(args.overrides)


def run_overrides(args: argparse.Namespace) -> list[str]:
    """Entries of `skyhaul run`: its own flags, then --set, which wins.

    Raises:
        ConfigError: For `--perception full`: flights on cameras alone are not safe yet.
    """
    if args.perception == "full":
        raise ConfigError(
            "--perception full: a team that sees obstacles by its cameras alone does not yet reach "
            "the goal on every seed; fly with --perception truth, or try it with --set "
            "perception.team.kind=fused perception.odometry.kind=ekf "
            "perception.obstacles.kind=cameras"
        )
    flags = []
    if args.trigger is not None:
        flags.append(f"mission.trigger.kind={args.trigger}")
    if args.latency != "none":
        flags.append(f"mission.latency={args.latency}")
    return flags + overrides_of(args)
