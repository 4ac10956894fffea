# SPDX-License-Identifier: Apache-2.0
"""Entry point of `skyhaul`: parse the command line, call one command, turn errors into one line.

Exit codes: 0 done, 3 the mission failed, 1 bad input or a fault of ours, 2 wrong usage,
130 interrupted (Ctrl-C): one sentence says what is kept and how to go on.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from skyhaul.errors import SkyhaulError

EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_FAILED = 0, 1, 2, 3
EXIT_INTERRUPTED = 130

_KEPT = {
    "record": "what is whole is kept in {out}; the same command goes on from there",
    "train-events": "what is whole is kept in {work}; the same command goes on from there",
    "report": "the flight in {run} is as it was; the same command makes its report",
}
"""What an interrupt leaves, by command; otherwise nothing, or what the interrupt's notes say."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    args = parser().parse_args(one_set_each(sys.argv[1:] if argv is None else argv))
    try:
        code = command(args.command)(args)
        sys.stdout.flush()
        return code
    except SkyhaulError as error:
        return _fail(str(error))
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_ERROR
    except KeyboardInterrupt as stop:
        kept = _KEPT.get(args.command, "nothing was written").format(**vars(args))
        notes = getattr(stop, "__notes__", [kept])
        print(f"skyhaul: {'; '.join(['interrupted', *notes])}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except Exception as error:
        if args.debug:
            raise
        return _fail(f"a fault of ours: {_one_line(error)}; run with --debug for the traceback")


def one_set_each(argv: Sequence[str]) -> list[str]:
    """`--set A=1 B=2 NAME` as `--set A=1 --set B=2 NAME`: entries hold `=`, names do not."""
    spread: list[str] = []
    after_entry = False
    for word in argv:
        is_first = spread[-1:] == ["--set"]
        is_next = after_entry and "=" in word and not word.startswith("-")
        spread += ["--set", word] if is_next else [word]
        after_entry = is_first or is_next
    return spread


def parser() -> argparse.ArgumentParser:
    """The command line; nothing heavy is imported for it."""
    shared = argparse.ArgumentParser(add_help=False)
    shared.add_argument("--debug", action="store_true", help="show the traceback of a fault")
    top = argparse.ArgumentParser(
        prog="skyhaul",
        description="Teams of quadrotors carry a load on cables through a moving world.",
    )
    top.add_argument("--version", action="version", version=f"skyhaul {_version()}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_run(commands.add_parser("run", parents=[shared], help="fly a scenario"))

    report = commands.add_parser("report", parents=[shared], help="make the report of a run")
    report.add_argument("run", metavar="RUN", type=Path, help="run folder")
    report.add_argument("--video", action="store_true", help="also make an MP4 (extra `video`)")

    _add_record(commands.add_parser("record", parents=[shared], help="make a sensor data set"))

    commands.add_parser("scenarios", parents=[shared], help="list the scenarios that ship")

    config = commands.add_parser("config", parents=[shared], help="print the whole configuration")
    _add_scenario(config)

    _add_events(commands.add_parser(
        "events", parents=[shared], help="what moves in a recording of an event camera"
    ))  # fmt: skip

    _add_train_events(
        commands.add_parser("train-events", parents=[shared], help="train the event network")
    )
    doctor = commands.add_parser(
        "doctor", parents=[shared], help="what this machine has and what a team can bear"
    )
    doctor.add_argument("scenario", metavar="SCENARIO", nargs="?", help="name or YAML file")
    _add_vio(commands.add_parser("vio", parents=[shared], help="track a recorded flight"))
    return top


def command(name: str) -> Callable[[argparse.Namespace], int]:
    """The function behind a command, imported only now."""
    match name:
        case "run":
            from skyhaul.cli.run import run

            return run
        case "report":
            from skyhaul.cli.report import report

            return report
        case "record":
            from skyhaul.cli.record import record

            return record
        case "scenarios":
            from skyhaul.cli.scenarios import scenarios

            return scenarios
        case "config":
            from skyhaul.cli.config import config

            return config
        case "vio":
            # Its matrices are small: more threads of BLAS would only wait for each other.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
            from skyhaul.cli.vio import vio

            return vio
        case "events":
            from skyhaul.cli.events import events

            return events
        case "train-events":
            from skyhaul.cli.train_events import train_events

            return train_events
        case _:
            from skyhaul.cli.doctor import doctor

            return doctor


def _add_run(run: argparse.ArgumentParser) -> None:
    _add_scenario(run)
    run.add_argument(
        "--perception",
        choices=("truth", "full"),
        default="truth",
        help="where estimates come from (default: truth)",
    )
    run.add_argument(
        "--trigger",
        choices=("event", "periodic", "periodic-feedback"),
        help="when the payload controller re-solves (default: as the scenario says)",
    )
    run.add_argument(
        "--latency",
        choices=("none", "measured"),
        default="none",
        help="measured: each result is late by the time it took (default: none)",
    )
    run.add_argument("--seed", type=_seed, default=0, help="phases, wind, noise (default: 0)")
    run.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/...)")


def _add_record(record: argparse.ArgumentParser) -> None:
    _add_scenario(record)
    record.add_argument(
        "--dataset", required=True, metavar="FORMAT", help="format of the data set: euroc"
    )
    record.add_argument("--out", type=Path, metavar="DIR", required=True, help="where to")
    record.add_argument("--seed", type=_seed, default=0, help="phases, wind, noise (default: 0)")
    record.add_argument(
        "--vehicles", metavar="I,J,..", help="vehicles whose sensors are simulated (default: all)"
    )
    record.add_argument(
        "--workers", type=_workers, default=1, help="processes that simulate (default: 1)"
    )


def _add_vio(vio: argparse.ArgumentParser) -> None:
    vio.add_argument(
        "dataset",
        metavar="DATASET",
        type=Path,
        help="EuRoC folder or feature-track CSV (docs/vio.md)",
    )
    vio.add_argument("--truth", type=Path, metavar="FILE", help="true trajectory: EuRoC or TUM")
    vio.add_argument("--out", type=Path, metavar="FILE", help="write the trajectory as TUM text")
    vio.add_argument("--json", action="store_true", help="print the figures as JSON")
    vio.add_argument(
        "--kind",
        choices=("smoother", "ekf"),
        default="smoother",
        help="estimator (default: smoother)",
    )
    vio.add_argument(
        "--loops",
        action="store_true",
        help="close loops where a place is seen again; EuRoC folders only",
    )
    vio.add_argument(
        "--align",
        choices=("se3", "sim3", "none"),
        default="se3",
        help="how the estimate is laid onto the truth for the ATE (default: se3)",
    )
    vio.add_argument(
        "--sigma-px",
        type=_sigma_px,
        default=1.2,
        metavar="PX",
        help="standard deviation of a track (default: 1.2 px)",
    )


def _add_events(to: argparse.ArgumentParser) -> None:
    to.add_argument(
        "file", metavar="FILE", type=Path, help="`t x y p` text, .es, .h5, .aedat4, .raw"
    )
    to.add_argument("--json", action="store_true", help="print the numbers as JSON")
    to.add_argument(
        "--calib",
        type=Path,
        metavar="FILE",
        help="lens, `fx fy cx cy k1 k2 p1 p2 k3` (default: calib.txt beside FILE, if there)",
    )
    to.add_argument(
        "--rate",
        type=float,
        nargs=3,
        metavar=("WX", "WY", "WZ"),
        help="the camera's angular rate in its own axes [rad/s] (default: motion.txt, or none)",
    )
    to.add_argument(
        "--kind",
        choices=("network", "timestamp"),
        default="network",
        help="what tells movers (default: network)",
    )
    to.add_argument(
        "--weights", type=Path, metavar="FILE", help="the network's weights (default: the shipped)"
    )
    to.add_argument("--out", type=Path, metavar="DIR", help="write a video of movers and tracks")


def _add_train_events(to: argparse.ArgumentParser) -> None:
    to.add_argument(
        "--out", type=Path, metavar="FILE", default=Path("event-network.npz"),
        help="weights file to write (default: event-network.npz)",
    )  # fmt: skip
    to.add_argument(
        "--work", type=Path, metavar="DIR", default=Path("train-events"),
        help="folder for flights, scenes and checkpoints; a training that was broken off goes on "
        "from it (default: train-events)",
    )  # fmt: skip
    to.add_argument("--seed", type=_seed, default=0, help="draws scenes and training (default: 0)")
    to.add_argument("--scenes", type=int, default=110, help="scenes to learn from (default: 110)")
    to.add_argument(
        "--held-out", type=int, default=16, help="scenes of other flights to judge by (default: 16)"
    )
    to.add_argument(
        "--updates", type=int, default=4000, help="steps of the optimiser (default: 4000)"
    )
    to.add_argument(
        "--no-edge-term", action="store_true", help="leave e_ij out of the network: an ablation"
    )


def _add_scenario(to: argparse.ArgumentParser) -> None:
    to.add_argument("scenario", metavar="SCENARIO", help="name or YAML file")
    to.add_argument(
        "--set",
        dest="overrides",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change an entry, as in --set limits.v_max_mps=1.0; more may follow, or repeat it",
    )


def _seed(text: str) -> int:
    return _whole(text, 0, "a seed is a whole number, 0 or more")


def _workers(text: str) -> int:
    return _whole(text, 1, "the number of processes is a whole number, 1 or more")


def _whole(text: str, least: int, allowed: str) -> int:
    """A whole number of at least `least`; otherwise a sentence that says what is allowed."""
    if not (text.isascii() and text.removeprefix("-").isdigit()) or int(text) < least:
        raise argparse.ArgumentTypeError(f"{allowed}, got {text!r}")
    return int(text)


def _sigma_px(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.01 <= value <= 100.0:
        raise argparse.ArgumentTypeError(f"a number from 0.01 to 100 [px], got {text!r}")
    return value


def _version() -> str:
    from importlib.metadata import version

    return version("skyhaul")


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split())
    name = type(error).__name__
    return "; ".join([f"{name}: {text}" if text else name, *getattr(error, "__notes__", ())])


def _fail(sentence: str) -> int:
    print(f"skyhaul: {sentence}", file=sys.stderr)
    return EXIT_ERROR
