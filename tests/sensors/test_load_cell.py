# SPDX-License-Identifier: Apache-2.0
"""The load cell against the tension it is given."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.model.state import CableState
from skyhaul.sensors.load_cell import LoadCell


def read(cell, make_truth, tensions, body=2, seed=0):
    """Readings of the vehicle 1's cell for tensions, one every 2 ms."""
    base = make_truth([[0, 0, 1], [1, 0, 1]], [], np.zeros((0, 3)))
    memory, out = cell.init(seed, body), []
    for k, tension in enumerate(tensions):
        cables = CableState(
            base.cables.dir_W, base.cables.w_W, np.array([99.0, tension]), base.cables.length
        )
        truth = replace(base, stamp_us=2000 * k, cables=cables)
        memory, reading = cell.step(memory, truth)
        out.append(reading)
    return memory, [r for r in out if r is not None]


def test_without_errors_it_reads_the_tension_of_its_own_cable(make_truth) -> None:
    ideal = LoadCell(noise_n=0.0, zero_n=0.0, scale_error=0.0)
    _, readings = read(ideal, make_truth, np.arange(11) * 0.1)
    assert [r.stamp_us.tolist() for r in readings] == [[0], [10_000], [20_000]]
    assert [r.tension[0] for r in readings] == pytest.approx([0.0, 0.5, 1.0])


def test_its_errors_have_the_size_they_are_given(make_truth) -> None:
    cell = LoadCell(rate_hz=500, noise_n=0.05, zero_n=0.3, scale_error=0.1)
    memory, readings = read(cell, make_truth, np.full(3000, 5.0))
    values = np.array([r.tension[0] for r in readings])
    assert values.mean() == pytest.approx(memory.scale * 5.0 + memory.zero_n, abs=0.005)
    assert values.std() == pytest.approx(0.05, rel=0.05)
    units = [cell.init(seed, 1) for seed in range(400)]
    assert np.std([u.scale for u in units]) == pytest.approx(0.1, rel=0.1)
    assert np.std([u.zero_n for u in units]) == pytest.approx(0.3, rel=0.1)


def test_beyond_its_range_it_saturates(make_truth) -> None:
    _, readings = read(LoadCell(range_n=3.0), make_truth, [50.0])
    assert readings[0].tension.tolist() == [3.0]


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ({"rate_hz": 3}, "rate_hz must divide 500, got 3"),
        ({"noise_n": -0.1}, "noise_n must be >= 0"),
        ({"range_n": 0.0}, "range_n must be > 0"),
    ],
)
def test_impossible_parameters_are_refused(entry, sentence) -> None:
    with pytest.raises(ValueError, match=sentence):
        LoadCell(**entry)
