# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from skyhaul.evaluation import extremes
from skyhaul.evaluation.extremes import CLEARANCE, DISTANCE, ENERGY, SLACK, Extremes


def followed(steps: int = 40, **fixed: np.ndarray) -> tuple[Extremes, dict[str, np.ndarray]]:
    """Running values after random steps, and the steps."""
    rng = np.random.default_rng(5)
    n = 3
    data = {
        "clearance": rng.normal(1.0, 0.5, steps),
        "p_WB": rng.normal(size=(steps, n, 3)),
        "rotor": rng.uniform(0.0, 1.2, (steps, n, 4)),
        "tension": rng.uniform(0.1, 2.0, (steps, n)),
        "attached": np.ones((steps, n), dtype=bool),
        "alive": np.ones((steps, n), dtype=bool),
    } | fixed
    e = extremes.start(n)
    for k in range(steps):
        extremes.follow(e, *(data[key][k] for key in data), 0.5, 0.002)
    return e, data


def test_extremes_and_sums_equal_those_of_all_steps() -> None:
    e, data = followed()
    gaps = np.linalg.norm(data["p_WB"][:, :, None] - data["p_WB"][:, None], axis=3)
    assert e.team[CLEARANCE] == data["clearance"].min()
    assert e.team[DISTANCE] == pytest.approx(gaps[gaps > 0.0].min())
    assert e.team[ENERGY] == pytest.approx(0.5 * (data["rotor"] ** 1.5).sum())
    assert e.team[SLACK] == 0.0
    np.testing.assert_array_equal(e.tension_min, data["tension"].min(axis=0))
    np.testing.assert_array_equal(e.tension_max, data["tension"].max(axis=0))
    np.testing.assert_allclose(e.thrust_max, data["rotor"].sum(axis=2).max(axis=0))


@pytest.mark.parametrize("what", ["attached", "alive"])
def test_a_vehicle_that_does_not_carry_counts_no_tension(what: str) -> None:
    gone = np.ones((40, 3), dtype=bool)
    gone[:, 1] = False
    tension = np.ones((40, 3))
    tension[:, 1] = 0.0
    e, data = followed(tension=tension, **{what: gone})
    np.testing.assert_array_equal(e.tension_min, [1.0, np.inf, 1.0])
    assert e.team[SLACK] == 0.0
    apart = np.linalg.norm(data["p_WB"][:, 0] - data["p_WB"][:, 2], axis=1).min()
    assert e.team[DISTANCE] == pytest.approx(apart)


def test_slack_time_counts_steps_once_however_many_cables_are_slack() -> None:
    tension = np.ones((40, 3))
    tension[10:15] = 0.0
    e, _ = followed(tension=tension)
    assert e.team[SLACK] == pytest.approx(5 * 0.002)


def test_a_new_row_forgets_extremes_and_keeps_sums() -> None:
    e, data = followed()
    energy = e.team[ENERGY]
    extremes.restart(e, keep_clearance=True)
    assert e.team[CLEARANCE] == data["clearance"].min()
    extremes.restart(e, keep_clearance=False)
    assert np.isinf(e.team[CLEARANCE])
    assert np.isinf(e.team[DISTANCE])
    assert np.isinf(e.thrust_max).all()
    assert e.team[ENERGY] == energy
