# SPDX-License-Identifier: Apache-2.0
"""`skyhaul report`: table, report and video of a run that was flown before."""

import argparse

from skyhaul.errors import FileError
from skyhaul.evaluation.metrics import evaluate
from skyhaul.evaluation.report import write_report
from skyhaul.evaluation.table import print_table


def report(args: argparse.Namespace) -> int:
    """Judge a run folder anew and write its report.

    Raises:
        FileError: When it is no run folder.
    """
    if not args.run.is_dir():
        raise FileError(f"{args.run}: no such run folder")
    if not (args.run / "config.yaml").is_file():
        raise FileError(f"{args.run}: is no run folder, it has no config.yaml")
    print_table(evaluate(args.run))
    write_report(args.run, video=args.video)
    print(f"report: {args.run / 'report.html'}")
    return 0
