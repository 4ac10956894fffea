# SPDX-License-Identifier: Apache-2.0
"""Writes the tables of the README and of docs/results.md from benchmarks/results/*.json.

A result file is {"claim": one sentence, "rows": [{"measure", "value", "unit", "bar"}, ...],
"commit", "machine", "seeds", ...}; files without `rows` are left out. The README's part between
the two marks is replaced by the rows that have a bar; docs/results.md holds all rows.
"""

import json
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"


def table(results: list[dict[str, Any]], *, only_barred: bool = False) -> str:
    """Markdown table of all rows, or of those that have a bar, in the order of the files."""
    lines = ["| Measure | Value | Bar |", "|---|---|---|"]
    for result in results:
        for row in result["rows"]:
            if only_barred and not row.get("bar"):
                continue
            value = f"{_number(row['value'])} {row.get('unit', '')}".strip()
            lines.append(f"| {row['measure']} | {value} | {row.get('bar', '')} |")
    return "\n".join(lines)


def insert(readme: str, text: str) -> str:
    """The README with the text between its two marks."""
    head, rest = readme.split(BEGIN)
    _, tail = rest.split(END)
    return f"{head}{BEGIN}\n{text}\n{END}{tail}"


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Every result that has rows, by file name."""
    results = [json.loads(path.read_text("utf-8")) for path in sorted(folder.glob("*.json"))]
    return [r for r in results if isinstance(r, dict) and r.get("rows")]


def main() -> None:
    """Rewrite the README's table and docs/results.md."""
    readme, results = ROOT / "README.md", read_results(ROOT / "benchmarks" / "results")
    text = insert(readme.read_text("utf-8"), table(results, only_barred=True))
    readme.write_text(text, "utf-8")
    everything = f"# Results\n\nAll rows of `benchmarks/results/`.\n\n{table(results)}\n"
    (ROOT / "docs" / "results.md").write_text(everything, "utf-8")
    print(table(results))


def _number(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
