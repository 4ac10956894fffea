# SPDX-License-Identifier: Apache-2.0
"""Allan deviation against its definition, against closed forms and against our IMU."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.evaluation.allan import allan_deviation, fit_noise, log_counts
from skyhaul.sensors.imu import Imu, imu_bank, without_errors
from skyhaul.sensors.imu_kernel import imu_still


def test_it_is_the_definition_written_out() -> None:
    samples = np.random.default_rng(0).normal(size=60).cumsum()
    for m in (1, 3, 7):
        means = [samples[k : k + m].mean() for k in range(60 - m + 1)]
        steps = [0.5 * (means[k + m] - means[k]) ** 2 for k in range(60 - 2 * m + 1)]
        (got,) = allan_deviation(samples, 0.1, [m])
        assert got == pytest.approx(np.sqrt(np.mean(steps)))


def test_white_noise_falls_with_the_root_of_time_and_a_ramp_rises_with_time() -> None:
    noise = np.random.default_rng(1).normal(scale=2.0, size=200_000)
    np.testing.assert_allclose(
        allan_deviation(noise, 0.01, [1, 100]), [2.0, 0.2], rtol=[0.01, 0.05][1]
    )
    ramp = 3.0 * 0.01 * np.arange(1000.0)
    assert allan_deviation(ramp, 0.01, [50])[0] == pytest.approx(3.0 * 0.5 / np.sqrt(2.0))


def test_means_over_the_base_period_give_the_same_deviation() -> None:
    samples = np.random.default_rng(2).normal(size=10_000).cumsum()
    means = samples.reshape(-1, 10).mean(axis=1)
    fast = allan_deviation(samples, 0.01, [100])
    slow = allan_deviation(means, 0.1, [10])
    np.testing.assert_allclose(fast, slow, rtol=0.02)  # overlap differs


def test_averaging_counts_rise_and_fit_into_the_record() -> None:
    counts = log_counts(10_000)
    assert counts[0] == 1
    assert counts[-1] == 500
    assert np.all(np.diff(counts) > 0)


def test_a_record_of_our_imu_gives_its_parameters_back() -> None:
    imu = replace(
        without_errors(Imu()),
        gyro_noise_radps_per_sqrt_hz=2e-3, gyro_walk_radps2_per_sqrt_hz=1e-3,
        accel_noise_mps2_per_sqrt_hz=0.01, accel_walk_mps3_per_sqrt_hz=0.02,
    )  # fmt: skip
    bank = imu_bank([imu], [1])
    memory = bank.init(0)
    noise = np.random.default_rng(3).standard_normal((500 * 1800, 12))
    out = np.empty((len(noise), 6))
    rest = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
    imu_still(bank.arrays, memory.errors, rest, noise, memory.state[0].copy(), out)
    means = out.reshape(-1, 25, 6).mean(axis=1)
    for axis in range(6):
        fit = fit_noise(means[:, axis], 0.05)
        white, walk = (2e-3, 1e-3) if axis < 3 else (0.01, 0.02)
        assert fit.white == pytest.approx(white, rel=0.05)
        assert fit.walk == pytest.approx(walk, rel=0.15)
