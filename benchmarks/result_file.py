# SPDX-License-Identifier: Apache-2.0
"""The result file of a benchmark of flights: rows for the README, every flight, machine, commit."""

import argparse
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fly import Flown
from provenance import provenance, write_report


@dataclass(frozen=True)
class Row:
    """One line of the table: what was measured, and what was asked."""

    measure: str
    value: float | int | str | None
    unit: str = ""
    bar: str = ""


@dataclass(frozen=True)
class Result:
    """What a benchmark found."""

    name: str
    claim: str
    rows: Sequence[Row]
    flights: Sequence[Flown]
    keys: Sequence[str]
    """Metrics that are kept of every flight."""
    notes: Mapping[str, Any]
    """Definitions, tables and whatever else a reader needs."""


def publish(result: Result, *, write: bool) -> None:
    """Print the rows and, unless this was a small case, write `results/<name>.json`."""
    for row in result.rows:
        print(f"{row.measure}: {_text(row.value)} {row.unit}  [{row.bar}]")
    if not write:
        return
    report = {
        "claim": result.claim,
        "rows": [vars(row) for row in result.rows],
        **result.notes,
        "seeds": sorted({f.job.seed for f in result.flights}),
        "flights": [entry(f, result.keys) for f in result.flights],
        **provenance([f.calibration_s for f in result.flights]),
    }
    print(f"-> {write_report(result.name, report)}")


def entry(flown: Flown, keys: Sequence[str]) -> dict[str, Any]:
    """One flight in the file."""
    about = {"case": flown.job.case, "scenario": flown.job.scenario, "seed": flown.job.seed}
    about["overrides"] = list(flown.job.overrides)
    kept = ("mission_success", "outcome", *keys)
    about |= {k: flown.metrics.get(k) for k in kept}
    return about | {"calibration_s": flown.calibration_s, "commit": flown.commit}


def successes(flights: Sequence[Flown]) -> str:
    """How many of the flights did their mission, as in 9/10."""
    return f"{sum(f.success for f in flights)}/{len(flights)}"


def numbers(flights: Sequence[Flown], key: str) -> list[float]:
    """A metric of all flights that have it."""
    return [float(v) for f in flights if (v := f.metrics.get(key)) is not None]


def least(flights: Sequence[Flown], key: str) -> float | None:
    """Smallest value of a metric."""
    return min(numbers(flights, key), default=None)


def most(flights: Sequence[Flown], key: str) -> float | None:
    """Largest value of a metric."""
    return max(numbers(flights, key), default=None)


def median(flights: Sequence[Flown], key: str) -> float | None:
    """Median of a metric over the flights."""
    found = numbers(flights, key)
    return statistics.median(found) if found else None


def spread(flights: Sequence[Flown], key: str, scale: float = 1.0) -> str:
    """Median and range of a metric, as in `3.1 (2.9 .. 3.4)`."""
    found = [scale * v for v in numbers(flights, key)]
    if not found:
        return "none"
    middle = statistics.median(found)
    return f"{middle:.3g} ({min(found):.3g} .. {max(found):.3g})"


def arguments(about: str, *flags: tuple[str, str]) -> argparse.Namespace:
    """Flags that the benchmarks share: --quick, --workers, and switches of their own."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--quick", action="store_true", help="a small case; writes nothing")
    parser.add_argument("--workers", type=int, default=2, help="processes (default: 2)")
    for flag, text in flags:
        parser.add_argument(flag, action="store_true", help=text)
    return parser.parse_args()


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
