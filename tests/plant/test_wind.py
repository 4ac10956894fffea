# SPDX-License-Identifier: Apache-2.0
"""Tests of `plant.wind`."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm

from skyhaul.plant.wind import is_calm, wind_model
from skyhaul.world.scenario import Gust, Wind

ROUGH = Wind(mean_mps=(0.0, 2.0, 0.0), turbulence_mps=0.5, length_scale_m=1.0)


def series(wind, dt, count, seed=0):
    model = wind_model(wind, dt)
    memory, rows = model.init(seed), []
    for k in range(count):
        rows.append(model.at(memory, k * dt))
        model.step(memory)
    return np.array(rows) - np.array(wind.mean_mps)


def test_turbulence_has_the_stated_spread_and_the_dryden_correlation():
    """Along the wind exp(-r), across and up (1 - r / 2) exp(-r), r = V t / L."""
    dt = 0.05
    u = series(ROUGH, dt, 60_000)
    np.testing.assert_allclose(np.std(u, axis=0), 0.5, rtol=0.05)
    np.testing.assert_allclose(np.mean(u, axis=0), 0.0, atol=0.03)
    for lag in (3, 8, 15):
        r = 2.0 * lag * dt
        measured = np.mean(u[lag:] * u[:-lag], axis=0) / 0.25
        across, along = (1.0 - 0.5 * r) * np.exp(-r), np.exp(-r)
        np.testing.assert_allclose(measured, [across, along, across], atol=0.06)


def test_the_transverse_filter_has_the_dryden_spectrum():
    """Response of states (Phi, spread) to unit noise against tau (1 + 3 x) / (1 + x)^2."""
    tau, dt = 0.5, 1e-3
    model = wind_model(ROUGH, dt)
    out = 0.5 * np.array([1.0, np.sqrt(3.0)])
    for omega in (0.3, 2.0, 8.0):
        z = np.exp(1j * omega * dt)
        gain = out @ np.linalg.solve(z * np.eye(2) - model.transition, model.spread)
        density = dt * np.sum(np.abs(gain) ** 2)
        x = (omega * tau) ** 2
        np.testing.assert_allclose(density, tau * (1 + 3 * x) / (1 + x) ** 2, rtol=1e-4)
    power = quad(lambda w: tau * (1 + 3 * (w * tau) ** 2) / (1 + (w * tau) ** 2) ** 2, 0, np.inf)
    np.testing.assert_allclose(power[0] / np.pi, 1.0, rtol=1e-6)


def test_the_transition_is_the_exponential_of_the_filter():
    model = wind_model(ROUGH, 0.1)
    filter_matrix = np.array([[0.0, 1.0], [-1.0, -2.0]]) / 0.5
    np.testing.assert_allclose(model.transition, expm(0.1 * filter_matrix), atol=1e-14)
    np.testing.assert_allclose(model.decay, np.exp(-0.2))


def test_two_steps_are_one_step_of_twice_the_length():
    once, twice = wind_model(ROUGH, 0.2), wind_model(ROUGH, 0.1)
    F, Q = twice.transition, twice.spread @ twice.spread.T
    np.testing.assert_allclose(once.transition, F @ F, atol=1e-14)
    np.testing.assert_allclose(once.spread @ once.spread.T, F @ Q @ F.T + Q, atol=1e-13)


@pytest.mark.parametrize("length_m", [0.5, 5.0, 533.0, 1e9])
def test_the_turbulence_is_stationary_at_every_length_scale(length_m):
    """Phi Phi^T + noise is I; for small steps h the first state is driven by 4/3 h^3."""
    model = wind_model(Wind(turbulence_mps=1.0, length_scale_m=length_m), 0.002)
    F, S = model.transition, model.spread
    np.testing.assert_allclose(F @ F.T + S @ S.T, np.eye(2), atol=1e-15)
    h = 0.002 / length_m
    np.testing.assert_allclose(S[0, 0] ** 2, 4.0 / 3.0 * h**3 * (1.0 - 1.5 * h), rtol=1e-4)
    np.testing.assert_allclose(S[1, 1] ** 2, h, rtol=5e-2)


def test_a_gust_rises_to_its_peak_and_dies():
    gust = Gust(start_s=1.0, duration_s=2.0, peak_mps=(4.0, 0.0, -1.0))
    model = wind_model(Wind(mean_mps=(1.0, 0.0, 0.0), gusts=(gust,)), 0.002)
    memory = model.init(0)
    for t, share in ((0.5, 0.0), (1.0, 0.0), (1.5, 0.5), (2.0, 1.0), (2.5, 0.5), (3.1, 0.0)):
        np.testing.assert_allclose(
            model.at(memory, t), [1.0 + 4.0 * share, 0.0, -share], atol=1e-12
        )


def test_the_seed_fixes_the_turbulence():
    np.testing.assert_array_equal(series(ROUGH, 0.1, 50, 3), series(ROUGH, 0.1, 50, 3))
    assert np.max(np.abs(series(ROUGH, 0.1, 50, 3) - series(ROUGH, 0.1, 50, 4))) > 0.1


def test_the_longitudinal_turbulence_blows_along_the_mean_wind():
    mean = np.array([3.0, 1.0, 0.0])
    model = wind_model(Wind(mean_mps=tuple(mean), turbulence_mps=0.5), 0.002)
    memory = model.init(0)
    memory.along, memory.across = 2.0, np.zeros((2, 2))
    np.testing.assert_allclose(model.at(memory, 0.0), mean * (1.0 + 1.0 / np.hypot(3.0, 1.0)))


@pytest.mark.parametrize("mean", [(0.0, 0.0, 0.0), (1.0, -3.0, 0.0), (0.0, 0.0, 2.0)])
def test_the_turbulence_axes_are_a_rotation_with_z_up(mean):
    R = wind_model(Wind(mean_mps=mean), 0.002).R_WU
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_array_equal(R[:, 2], [0.0, 0.0, 1.0])


def test_wind_without_turbulence_and_gusts_is_calm():
    assert is_calm(Wind(mean_mps=(1.0, 0.0, 0.0)))
    assert not is_calm(ROUGH)
