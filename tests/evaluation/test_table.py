# SPDX-License-Identifier: Apache-2.0
import io
from pathlib import Path

import pytest
from rich.console import Console

from skyhaul.evaluation.metrics import NOT_YET, evaluate
from skyhaul.evaluation.table import GROUPS, print_table, table_lines


@pytest.fixture(scope="module")
def metrics(run_folder: Path) -> dict[str, object]:
    return evaluate(run_folder)


def printed(metrics: dict) -> str:
    out = io.StringIO()
    print_table(metrics, Console(file=out, width=120))
    return out.getvalue()


def marks(metrics: dict) -> dict[str, bool | None]:
    return {x.label: x.good for _, lines in table_lines(metrics) for x in lines}


def test_a_good_run_has_no_bad_mark(metrics: dict) -> None:
    text = printed(metrics)
    assert "mission done" in text
    assert "BAD" not in text
    assert "<= 0.2" in text


@pytest.mark.parametrize(
    ("key", "value", "label"),
    [
        ("collisions", 1, "contacts after lift-off"),
        ("min_clearance_m", 0.0, "least clearance"),
        ("min_tension_n", 0.0, "least tension"),
        ("slack_time_s", 0.002, "time with a slack cable"),
        ("max_thrust_ratio", 1.01, "largest thrust / limit"),
        ("distance_to_goal_m", 0.21, "distance to the goal"),
        ("min_quad_distance_m", 0.29, "least distance of two vehicles, centres"),
        ("nmpc_failures", 1, "... that failed"),
    ],
)
def test_each_criterion_can_fail(metrics: dict, key: str, value: float, label: str) -> None:
    assert marks(metrics)[label] is True
    assert marks(metrics | {key: value})[label] is False


def test_the_fall_of_a_lost_vehicle_is_shown_but_not_held_against_the_run(metrics: dict) -> None:
    lost = metrics | {"collisions": 1, "collisions_lost_vehicle": 1}
    assert marks(lost)["contacts after lift-off"] is True
    assert "1  " in printed(lost)


def test_what_does_not_apply_is_left_out(metrics: dict) -> None:
    assert "odometry" not in printed(metrics)
    assert "odometry error" in printed(metrics | {"vio_ate_m": 0.04})


def test_every_metric_of_later_stages_has_its_line() -> None:
    keys = {row.key for _, rows in GROUPS for row in rows}
    assert set(NOT_YET) <= keys


def test_a_failed_run_says_why(metrics: dict) -> None:
    text = printed(metrics | {"mission_success": False, "outcome": "cable 1 touched post"})
    assert "mission failed (cable 1 touched post)" in text
