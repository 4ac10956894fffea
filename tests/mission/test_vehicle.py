# SPDX-License-Identifier: Apache-2.0
"""One agent: what it asks of its hardware under an order."""

from dataclasses import replace

import numpy as np
import pytest

from skyhaul.comms.messages import ORDER, PLAN, Order, PlanMessage
from skyhaul.mission.api import Phase
from skyhaul.mission.phases import spool_plan
from skyhaul.mission.tracking import SharedTracking
from skyhaul.mission.vehicle import VehicleAgent
from skyhaul.planning.heading import fan_out
from skyhaul.planning.reference import resting_reference
from skyhaul.world.scenario import AirStart

STEP_US = 2_000
ALL = np.ones(4, dtype=bool)


def agent_of(e, index=1):
    tracking = SharedTracking(e.stack.vehicle_control, e.stack.team.count)
    return VehicleAgent(index, e.stack, e.bus, tracking)


def plan_message(e, t_us=0):
    load = e.estimate(t_us).team.load
    reference = resting_reference(load[:3], 0.0, t_us)
    plan = spool_plan(e.stack, t_us, load, ALL)
    return PlanMessage(t_us, plan, reference, fan_out(reference, np.arange(4) * np.pi / 2, t_us))


def order(phase, t_us=0, since_us=0, *, active=ALL, retreat=False):
    return Order(t_us, phase.value, active, retreat, since_us)


def test_without_orders_the_rotors_stand_still(make_ensemble, ground_stack):
    ensemble = make_ensemble(ground_stack)
    agent = agent_of(ensemble)
    agent.hear(0)
    np.testing.assert_array_equal(agent.act(0, ensemble.estimate()).rotor_cmd, 0.0)
    ensemble.bus.publish(ORDER, 0, 0, order(Phase.CARRY))
    agent.hear(0)
    np.testing.assert_array_equal(agent.act(0, ensemble.estimate()).rotor_cmd, 0.0)


def test_a_team_that_begins_in_the_air_hovers_until_it_is_led(ensemble, make_ensemble):
    start = AirStart(payload_m=tuple(ensemble.estimate(0).team.p_WL))
    e = make_ensemble(replace(ensemble.stack, start=start))
    agent = agent_of(e)
    arrays = e.stack.arrays
    for t_us in (0, 200_000, 5_000_000):  # longer than any plan reaches
        agent.hear(t_us)
        act = agent.act(t_us, e.estimate(t_us))
        weight = arrays.m_B[1] * arrays.g + arrays.m_L * arrays.g / 4
        assert act.force_W[2] == pytest.approx(arrays.m_L * arrays.g / 4, rel=0.02)
        assert act.thrust == pytest.approx(np.hypot(weight, np.hypot(*act.force_W[:2])), rel=0.03)
    led = plan_message(e, 0)
    e.bus.publish(PLAN, 0, 0, led)
    agent.hear(5_000_000)
    assert agent.plan is led


def test_it_flies_the_newest_plan_that_it_heard(ensemble):
    agent = agent_of(ensemble)
    old, new = plan_message(ensemble, 0), plan_message(ensemble, 100)
    for message in (old, new):
        ensemble.bus.publish(PLAN, 0, 0, message)
    agent.hear(0)
    assert agent.plan is new


def test_in_the_lift_the_pull_grows_from_the_beginning_of_the_phase(ensemble):
    agent = agent_of(ensemble)
    agent.plan = plan_message(ensemble)
    spool_us = round(1e6 * ensemble.stack.mission.spool_s)
    pull = []
    for k, t_us in enumerate((0, spool_us // 2, spool_us, 3 * spool_us)):
        agent.order = order(Phase.LIFT, t_us * (k == 0))
        force = agent.act(t_us, ensemble.estimate(t_us)).force_W
        pull.append(np.linalg.norm(force))
    share = np.array(pull) / pull[-1]
    np.testing.assert_allclose(share, [0.2, 0.6, 1.0, 1.0], atol=0.02)


def test_a_second_order_in_the_lift_does_not_let_the_load_down(ensemble):
    agent = agent_of(ensemble)
    agent.plan = plan_message(ensemble)
    agent.order = order(Phase.LIFT)
    before = agent.act(800_000, ensemble.estimate(800_000)).force_W
    some = np.array([True, True, True, False])
    agent.order = order(Phase.LIFT, t_us=802_000, active=some)
    after = agent.act(802_000, ensemble.estimate(802_000)).force_W
    np.testing.assert_allclose(after, before, atol=1e-3)


def test_a_faulty_vehicle_lets_go_then_flies_clear_of_the_team(ensemble):
    agent = agent_of(ensemble)
    agent.plan, agent.order = plan_message(ensemble), order(Phase.CARRY)
    agent.faulty = frozenset({1})
    first = agent.act(0, ensemble.estimate())
    assert first.release
    np.testing.assert_array_equal(first.rotor_cmd, 0.0)
    free = np.array([True, False, True, True])
    for k in range(1, 500):
        estimate = ensemble.estimate(k * STEP_US, attached=free)
        act = agent.act(k * STEP_US, estimate)
        assert not act.release
    assert act.thrust > 0.5 * ensemble.stack.team.vehicle.mass_kg * 9.81
    out = estimate.team.p_WB[1] - estimate.team.p_WL
    away = agent._route.corners[-1] - agent._route.corners[0]
    clear_m = ensemble.stack.mission.station.clear_m
    assert np.hypot(*away[:2]) == pytest.approx(clear_m)
    assert away[:2] @ out[:2] == pytest.approx(clear_m * np.hypot(*out[:2]))


def test_a_heartbeat_tells_what_the_vehicle_knows(ensemble):
    agent = agent_of(ensemble)
    estimate = ensemble.estimate(
        0, tension=[0.1, 0.7, 0.2, 0.3], attached=[True, False, True, True]
    )
    status = agent.report(0, estimate)
    assert (status.vehicle, status.stamp_us) == (1, 0)
    assert status.tension == 0.7
    assert not status.attached
    assert not status.at_station
    np.testing.assert_array_equal(status.p_WB, estimate.team.p_WB[1])
    assert agent.report(2_000, replace(estimate, stamp_us=2_000)) is None


def test_a_fault_is_told_once(ensemble):
    agent = agent_of(ensemble)
    agent.plan = plan_message(ensemble)
    loose = [True, False, True, True]
    for k in range(30):
        agent.report(k * STEP_US, ensemble.estimate(k * STEP_US, attached=loose))
    assert [m.topic for m in ensemble.notes.messages].count("fault") == 1
    assert agent.faulty == {1}


def test_a_cable_that_is_not_hooked_yet_is_no_fault_before_there_is_a_plan(
    make_ensemble, ground_stack
):
    ensemble = make_ensemble(ground_stack)
    agent = agent_of(ensemble)
    for k in range(30):
        agent.report(k * STEP_US, ensemble.estimate(k * STEP_US, attached=[False] * 4))
    assert agent.faulty == frozenset()


def test_a_cable_that_comes_off_while_the_load_stands_on_the_floor_is_a_fault(ensemble):
    agent = agent_of(ensemble)
    agent.order = order(Phase.TAUTEN)
    agent.report(0, ensemble.estimate(0))
    assert agent.faulty == frozenset()
    agent.report(2_000, ensemble.estimate(2_000, attached=[True, False, True, True]))
    assert agent.faulty == {1}


def test_a_hook_that_does_not_close_is_a_fault_after_a_while(
    make_ensemble, ground_stack, with_mission
):
    station = replace(ground_stack.mission.station, attach_s=0.1, speed_mps=50.0)
    e = make_ensemble(with_mission(ground_stack, station=station))
    agent, loose = agent_of(e), [True, False, True, True]
    agent.order, asked_us = order(Phase.FLY_IN), []
    for k in range(600):
        t_us = k * STEP_US
        estimate = e.estimate(t_us, attached=loose)
        agent.report(t_us, replace(estimate, thrust=np.full(4, agent._thrust_cmd)))
        if agent.faulty:
            break
        if agent.act(t_us, estimate).attach:
            asked_us.append(t_us)
    (fault,) = [m.payload for m in e.notes.messages if m.topic == "fault"]
    assert fault.reason == "its hook does not close on the load"
    assert t_us - asked_us[0] == pytest.approx(100_000, abs=3 * STEP_US)


@pytest.mark.parametrize("phase", [Phase.ABORT, Phase.DOWN])
def test_a_take_off_that_is_called_off_leads_back_to_the_parking_place(ensemble, phase):
    agent = agent_of(ensemble)
    agent.plan, agent.order = plan_message(ensemble), order(Phase.TAUTEN)
    for k in range(250):
        agent.act(k * STEP_US, ensemble.estimate(k * STEP_US))
    assert agent._route.progress_s > 0.0
    agent.order = order(phase)
    for k in range(250, 1500):
        act = agent.act(k * STEP_US, ensemble.estimate(k * STEP_US))
    np.testing.assert_array_equal(act.rotor_cmd, 0.0)
    assert np.isinf(agent._station_in_s())


def test_on_the_way_to_the_station_the_vehicle_lifts_itself_and_comes_back_on_retreat(ensemble):
    agent = agent_of(ensemble)
    agent.order = order(Phase.TAUTEN)
    for k in range(250):
        agent.act(k * STEP_US, ensemble.estimate(k * STEP_US))
    progress = agent._route.progress_s
    assert progress > 0.0
    agent.order = order(Phase.TAUTEN, retreat=True)
    for k in range(250, 1500):
        act = agent.act(k * STEP_US, ensemble.estimate(k * STEP_US))
    assert agent._route.progress_s == 0.0
    np.testing.assert_array_equal(act.rotor_cmd, 0.0)
