# SPDX-License-Identifier: Apache-2.0
"""Samples that are false, told from those before."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.perception.team.false_samples import believed
from skyhaul.sensors.api import ImuReading

DT = 0.002


def judged(samples):
    """Which samples of (k, 6) at 500 Hz are believed, the first one given."""
    last, waiting, out = samples[0], np.array([-1.0, *np.zeros(6)]), []
    at = 0
    for k, x in enumerate(samples[1:], 1):
        fine = believed(last, waiting, np.array([2_000.0 * k, *x]), DT * (k - at))
        last, at = (x, k) if fine else (last, at)
        out.append(fine)
    return np.array(out)


def hovering(k=50):
    return np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 9.8], (k, 1))


@pytest.mark.parametrize("off", [20.0, -2.0, np.nan])
@pytest.mark.parametrize("column", [1, 4])
def test_a_sample_that_comes_and_goes_is_not_believed(column, off):
    samples = hovering()
    samples[20, column] += 20.0 * off if column > 2 else off
    assert np.flatnonzero(~judged(samples)).tolist() == [19]


@pytest.mark.parametrize("column", [1, 4])
def test_what_stays_is_believed_from_the_second_sample_on(column):
    samples = hovering()
    samples[20:, column] += 40.0
    assert np.flatnonzero(~judged(samples)).tolist() == [19]


def test_wild_samples_are_never_believed():
    samples = hovering()
    samples[20:, 0] = 50.0 * (-1.0) ** np.arange(30)
    assert not judged(samples)[19:].any()


def test_what_rotors_do_and_shake_is_believed():
    t = DT * np.arange(500)
    rng = np.random.default_rng(0)
    samples = np.zeros((500, 6))
    samples[:, :3] = np.outer(6.0 * np.sin(16.0 * np.pi * t), [1.0, 0.5, 0.0])  # 300 rad/s^2
    samples[:, 3:] = np.outer(9.8 + 10.0 * np.sign(np.sin(60.0 * t)), [0.0, 0.0, 1.0])
    samples += rng.normal(0.0, np.repeat([0.05, 0.5], 3), (500, 6))
    assert judged(samples).all()


def spoilt(imu, rate, force):
    return ImuReading(imu.stamp_us, imu.gyro_I + rate, imu.accel_I + force)


def test_the_team_bears_single_false_samples(flight):
    """Every 0.2 s one of each vehicle and one of the load."""
    made = flight(6, 3.0)
    reports = []
    for k, r in enumerate(made.reports):
        vehicles = tuple(
            replace(v, imu=spoilt(v.imu, [0.0, 20.0, 0.0], [60.0, 0.0, 0.0]))
            if k % 100 == 10 + i
            else v
            for i, v in enumerate(r.vehicles)
        )
        load = r.load_imu if k % 100 > 4 else spoilt(r.load_imu, [0.0, 9.0, 0.0], [0.0, 60.0, 0.0])
        reports.append(replace(r, vehicles=vehicles, load_imu=load))
    whole, estimates = estimates_of(made, made.reports), estimates_of(made, reports)
    pairs = list(zip(estimates, whole, strict=True))[250:]
    assert max(np.abs(x.team.p_WL - y.team.p_WL).max() for x, y in pairs) < 0.005
    assert max(np.abs(x.team.v_WL - y.team.v_WL).max() for x, y in pairs) < 0.02
    assert max(np.abs(x.team.p_WB - y.team.p_WB).max() for x, y in pairs) < 0.01
    assert max(np.abs(x.cables.tension - y.cables.tension).max() for x, y in pairs) < 0.1


def estimates_of(made, reports):
    estimator = made.estimator()
    memory, out = estimator.init(), []
    for reading in reports:
        memory, estimate = estimator.step(memory, reading)
        out.append(estimate)
    return out
