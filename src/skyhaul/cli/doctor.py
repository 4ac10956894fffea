# SPDX-License-Identifier: Apache-2.0
"""`skyhaul doctor`: what this machine has, and what the team of a scenario can bear."""

import argparse
import ctypes.util
import os
import platform
import shutil
import time
from importlib import metadata

import numpy as np

from skyhaul.control.failure import FailureRow, single_failure_table
from skyhaul.mission.config import RunConfig
from skyhaul.model.envelope import team_shape
from skyhaul.model.team import Team
from skyhaul.world.check import THRUST_SHARE_MAX, hover_thrusts
from skyhaul.world.load import load_config

PACKAGES = [
    "numpy",
    "scipy",
    "numba",
    "casadi",
    "mujoco",
    "pydantic",
    "pyyaml",
    "rich",
    "mcap",
    "opencv-contrib-python-headless",
    "h5py",
    "pyarrow",
    "plotly",
    "gtsam",
    "av",
    "matplotlib",
]
CALIBRATION_LOOPS = 5_000_000


def doctor(args: argparse.Namespace) -> int:
    """Print what is there; with a scenario, also its team's margins."""
    for name, value in machine():
        print(f"{name:<12} {value}")
    if args.scenario is not None:
        scenario = load_config(RunConfig, args.scenario)
        print(f"\nteam of {scenario.name}")
        for name, value in team_margins(scenario.team):
            print(f"  {name:<28} {value}")
    return 0


def machine() -> list[tuple[str, str]]:
    """Versions, compiler, EGL, cores and the calibration loop, as rows to print."""
    rows = [
        ("skyhaul", metadata.version("skyhaul")),
        ("python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("cores", str(os.cpu_count())),
    ]
    rows += [(name, _version(name)) for name in PACKAGES]
    compiler = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
    egl = ctypes.util.find_library("EGL")
    rows.append(("compiler", compiler or "none: the payload controller runs slower, nothing else"))
    rows.append(("EGL", egl or "none: not needed, only MuJoCo's own pictures use it"))
    seconds = calibration_s()
    rows.append(("calibration", f"{seconds:.3f} s for {CALIBRATION_LOOPS:,} turns of a loop"))
    return rows


def calibration_s() -> float:
    """Time of a fixed loop in pure Python [s]: the yardstick beside every timing we report."""
    began, total = time.perf_counter(), 0
    for i in range(CALIBRATION_LOOPS):
        total += i
    return time.perf_counter() - began


def team_margins(team: Team) -> list[tuple[str, str]]:
    """What the team can bear, as rows to print."""
    arrays, shape = team.arrays(), team_shape(team, 0.0)
    thrust = hover_thrusts(team)
    weight = float((arrays.m_L + arrays.m_B.sum()) * arrays.g)
    alone = (arrays.m_L + arrays.m_B) * arrays.g
    lifts = int(np.sum(alone <= arrays.thrust_max))
    rows = [
        ("vehicles", str(team.count)),
        ("weight, load included", f"{weight:.2f} N"),
        ("largest thrust, all", f"{arrays.thrust_max.sum():.2f} N"),
        ("hover thrust / largest", f"{np.max(thrust / arrays.thrust_max):.2f}"),
        (
            "heaviest load",
            f"{heaviest_load_kg(team):.2f} kg at {THRUST_SHARE_MAX:.0%} of the thrust; "
            f"it is {arrays.m_L:.2f} kg",
        ),
        ("vehicles that lift it alone", f"{lifts} of {team.count}"),
        ("cable angle", f"{np.degrees(team.cable_angle_rad):.1f} deg"),
        ("shape", f"{shape.radius_m:.2f} m around the load, {shape.above_m:.2f} m above it"),
    ]
    return rows + [(f"without vehicle {row.vehicle}", _loss(row)) for row in losses(team)]


def losses(team: Team) -> list[FailureRow]:
    """What the loss of each vehicle means; a team of one has nobody left."""
    return single_failure_table(team) if team.count > 1 else []


def _loss(row: FailureRow) -> str:
    if not row.survivable:
        return "no hover within the limits: the load is lost"
    return (
        f"tilt {row.tilt_deg:.0f} deg, tension {row.tension_min_n:.2f} to "
        f"{row.tension_max_n:.2f} N, thrust up to {row.thrust_ratio_max:.2f} of the largest"
    )


def heaviest_load_kg(team: Team) -> float:
    """Load with which the first vehicle needs the most that a scenario may ask in hover [kg].

    Each cable lifts x, and its vehicle gives |(m g + x, x tan angle)| = 0.9 thrust_max; 0 where
    a vehicle alone needs more.
    """
    a, tangent = team.arrays(), np.tan(team.cable_angle_rad)
    weight, square = a.m_B * a.g, 1.0 + tangent**2
    most = THRUST_SHARE_MAX * a.thrust_max
    root = np.sqrt(np.maximum(0.0, weight**2 - square * (weight**2 - most**2)))
    return max(0.0, float(np.min((root - weight) / square))) * team.count / a.g


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
