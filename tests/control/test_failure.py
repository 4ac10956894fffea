# SPDX-License-Identifier: Apache-2.0
"""Tests of `control.failure`. Each name states the property it checks."""

import numpy as np
import pytest

from skyhaul.control.failure import (
    LossLimits,
    Rotor,
    ThrustMonitor,
    equilibrium_after_loss,
    single_failure_table,
)
from skyhaul.model import PointPayload, RigidPayload, Team, Vehicle
from skyhaul.types import GRAVITY_MPS2


def without(team, *lost):
    return ~np.isin(np.arange(team.count), lost)


def check_equilibrium(team, e):
    weight = team.payload.mass_kg * GRAVITY_MPS2
    np.testing.assert_allclose(e.force_W.sum(axis=0), [0.0, 0.0, weight], atol=0.03)
    arm = team.hooks_L() @ e.R_WL.T
    np.testing.assert_allclose(np.cross(arm, e.force_W).sum(axis=0), 0.0, atol=5e-3)
    assert np.all(e.force_W[~e.active] == 0.0)
    assert e.tension[e.active].min() >= team.tension_min_n
    assert e.separation_m >= 0.9 * team.separation_m - 1e-3


@pytest.mark.parametrize("lost", range(4))
def test_three_of_four_hold_the_plate_at_a_tilt(lost):
    team = Team()
    e = equilibrium_after_loss(team, without(team, lost))
    assert e.survivable
    assert 15.0 < e.tilt_deg < 20.0
    assert e.tension[e.active].min() == pytest.approx(0.5, abs=0.1)
    check_equilibrium(team, e)


@pytest.mark.parametrize("n", [5, 6, 7, 8])
def test_with_five_or_more_the_load_stays_level(n):
    team = Team(count=n)
    e = equilibrium_after_loss(team, without(team, 1))
    assert e.survivable
    assert e.tilt_deg < 1e-6
    check_equilibrium(team, e)


def test_four_hooks_in_the_plane_of_the_centre_of_mass_do_not_survive():
    team = Team(payload=RigidPayload(hook_height_m=0.0))
    assert not equilibrium_after_loss(team, without(team, 0)).survivable


def test_two_cables_do_not_hold_a_rigid_load_but_a_point_mass():
    assert not equilibrium_after_loss(Team(count=3), without(Team(count=3), 0)).survivable
    team = Team(count=3, payload=PointPayload())
    e = equilibrium_after_loss(team, without(team, 0))
    assert e.survivable
    check_equilibrium(team, e)


def test_weak_vehicles_do_not_survive():
    team = Team(vehicle=Vehicle(thrust_max_n=3.1))
    assert not equilibrium_after_loss(team, without(team, 2)).survivable


def test_a_heavier_load_tilts_within_the_thrust_limit():
    team = Team(payload=RigidPayload(mass_kg=0.4))
    e = equilibrium_after_loss(team, without(team, 0))
    assert e.survivable
    assert not e.formation
    assert e.thrust_ratio.max() <= 0.951
    check_equilibrium(team, e)


def test_no_cable_left_is_no_equilibrium():
    team = Team(payload=PointPayload(), count=1)
    assert not equilibrium_after_loss(team, without(team, 0)).survivable


def test_table_tells_every_vehicle():
    rows = single_failure_table(Team())
    assert [r.vehicle for r in rows] == [0, 1, 2, 3]
    assert all(r.survivable for r in rows)
    assert all(0.1 < r.tension_min_n < r.tension_max_n < 1.5 for r in rows)
    np.testing.assert_allclose([r.tilt_deg for r in rows], rows[0].tilt_deg, atol=1e-6)
    weakest = single_failure_table(Team(), LossLimits(thrust_share=0.7))
    assert not any(r.survivable for r in weakest)


ROTOR = Rotor(thrust_max_n=4.24, lag_s=0.03)


def watch(commands, thrusts, dt=2e-3):
    """Times at which the monitor says that the vehicle is at fault [s]."""
    monitor = ThrustMonitor()
    memory, found = monitor.init(), []
    for k, (asked, given) in enumerate(zip(commands, thrusts, strict=True)):
        memory, fault = monitor.step(memory, asked, given, ROTOR, dt)
        found += [k * dt] if fault else []
    return found


def lagged(commands, start, dt=2e-3):
    out, y = [], start
    for c in commands:
        y += (1.0 - np.exp(-dt / ROTOR.lag_s)) * (c - y)
        out.append(y)
    return np.array(out)


def test_a_dead_vehicle_is_found_within_40_ms():
    asked = np.full(200, 3.0)
    given = np.where(np.arange(200) < 50, 3.0, 3.0 * np.exp(-(np.arange(200) - 50) * 2e-3 / 0.03))
    found = watch(asked, given)
    assert 0.1 < found[0] <= 0.1 + 0.04


def test_hard_manoeuvres_of_a_sound_vehicle_are_no_fault():
    rng = np.random.default_rng(0)
    asked = np.repeat(rng.uniform(0.2, 4.24, size=60), 10)
    assert watch(asked, lagged(asked, 3.0)) == []


def test_a_glitch_shorter_than_the_hold_is_no_fault():
    asked = np.full(100, 3.0)
    given = asked.copy()
    given[40:48] = 0.0
    assert watch(asked, given) == []


def test_bad_limits_are_refused():
    with pytest.raises(ValueError, match="thrust_share"):
        LossLimits(thrust_share=1.5)
    with pytest.raises(ValueError, match="gap_share"):
        ThrustMonitor(gap_share=0.0)
