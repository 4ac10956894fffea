# SPDX-License-Identifier: Apache-2.0
"""Every name in docs/paper_map.md exists."""

import ast
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "paper_map.md").read_text("utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in TEXT.splitlines()
    if re.match(r"\| *\d", line)
]


def names_in(cell: str) -> list[str]:
    """What stands between backticks."""
    return re.findall(r"`([^`]+)`", cell)


@cache
def functions_of(path: Path) -> frozenset[str]:
    """Names of the functions of a test file."""
    tree = ast.parse(path.read_text("utf-8"))
    return frozenset(n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))


def resolve(dotted: str) -> object:
    """The object behind `stage.module.name` or `stage.module.Class.method`."""
    parts = dotted.split(".")
    for split in range(len(parts), 0, -1):
        try:
            found: object = import_module(".".join(["skyhaul", *parts[:split]]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            found = getattr(found, part)
        return found
    raise AssertionError(f"no module of {dotted}")


def test_there_is_a_row_for_every_settled_point() -> None:
    numbers = [int(re.match(r"\d+", row[0])[0]) for row in ROWS]  # type: ignore[index]
    assert sorted(set(numbers)) == numbers
    assert set(range(1, 35)) <= set(numbers)
    assert all(len(row) == 5 for row in ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_function_and_every_test_of_a_row_exists(row: list[str]) -> None:
    _, _, code, tests, _ = row
    assert names_in(code), "a row names its code"
    for dotted in names_in(code):
        resolve(dotted)
    for name in names_in(tests):
        file, test = name.split("::")
        assert test in functions_of(ROOT / "tests" / file), name
