# SPDX-License-Identifier: Apache-2.0
"""The agents together: who leads, who knows what, and that nothing passes but by the bus."""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import pytest

from skyhaul.mission.api import Phase
from skyhaul.mission.crew import Crew
from skyhaul.mission.hearing import SILENT_US
from skyhaul.mission.loop import cycle
from skyhaul.mission.vehicle import _stamp_us

STEP_US, LOOK_US = 2_000, 20_000


def crew_of(e):
    crew = Crew(e.stack, e.bus, e.notes, e.watch)
    crew.rotors = np.full(e.stack.team.count, 3.0)
    return crew


def run(crew, e, steps, first=0, dead=(), **changes):
    """Cycles of a team that hovers; returns what was asked of the hardware last.

    Rotors come to what is asked of them with their lag, those of dead vehicles give nothing.
    """
    share = 1.0 - np.exp(-1e-6 * STEP_US / e.stack.arrays.motor_lag)
    for k in range(first, first + steps):
        t_us = STEP_US * k
        seen = None if t_us % LOOK_US else e.nothing_seen(t_us)
        crew.rotors += share * (np.array([a._thrust_cmd for a in crew.agents]) - crew.rotors)
        crew.rotors[list(dead)] = 0.0
        estimate = replace(e.estimate(t_us, **changes), thrust=crew.rotors.copy())
        actuations = cycle(crew, t_us, estimate, seen)
    return actuations


def test_everyone_has_the_plan_one_tick_after_the_leader(ensemble):
    crew = crew_of(ensemble)
    run(crew, ensemble, 1)
    plan = crew.leader.forces.message
    assert plan is not None
    assert [a.plan is plan for a in crew.agents] == [True, False, False, False]
    run(crew, ensemble, 1, first=1)
    assert all(a.plan is plan for a in crew.agents)
    assert all(a.order is crew.leader.order for a in crew.agents)


def test_with_a_delay_the_followers_fly_the_old_plan_until_the_new_one_arrives(
    make_ensemble, stack
):
    e = make_ensemble(stack, delay_ms=30.0)
    crew = crew_of(e)
    run(crew, e, 15)
    assert [_stamp_us(a.plan) for a in crew.agents] == [0, -1, -1, -1]
    run(crew, e, 1, first=15)
    assert all(a.plan is crew.leader.forces.message for a in crew.agents)


def test_agents_with_the_same_plan_ask_for_what_one_controller_of_all_would(ensemble):
    crew, stack = crew_of(ensemble), ensemble.stack
    run(crew, ensemble, 1)
    acts = run(crew, ensemble, 1, first=1)
    rotors = np.array([a.rotor_cmd for a in acts])
    weight = stack.arrays.g * (stack.arrays.m_L + stack.arrays.m_B.sum())
    lean = np.array([a.thrust for a in acts])
    assert rotors.shape == (4, 4)
    assert weight < lean.sum() < 1.1 * weight  # the cables lean outward, so a little more


def test_every_vehicle_reports_fifty_times_a_second_and_the_leader_hears_all(ensemble):
    crew = crew_of(ensemble)
    run(crew, ensemble, 500)
    sent = Counter(m.sender for m in ensemble.notes.messages if m.topic == "status")
    assert sent == dict.fromkeys(range(4), 50)
    assert sorted(crew.leader._statuses) == [0, 1, 2, 3]
    assert {s.stamp_us for s in crew.leader._statuses.values()} == {980_000}


def test_a_vehicle_off_its_cable_is_left_out_by_all(ensemble):
    crew = crew_of(ensemble)
    run(crew, ensemble, 20)
    run(crew, ensemble, 15, first=20, attached=[True, True, False, True])
    assert crew.leader.index == 0
    assert all(a.faulty == {2} for a in crew.agents)
    np.testing.assert_array_equal(crew.leader.active, [True, True, False, True])
    assert all(a.plan is crew.leader.forces.message for a in crew.agents)
    np.testing.assert_array_equal(crew.agents[3].plan.plan.active, [True, True, False, True])
    (fault,) = [m.payload for m in ensemble.notes.messages if m.topic == "fault"]
    assert (fault.vehicle, fault.reason) == (2, "its cable is off the load")


def test_leadership_passes_to_the_lowest_vehicle_that_is_not_faulty(ensemble):
    crew = crew_of(ensemble)
    run(crew, ensemble, 20)
    plan = crew.leader.forces.message
    run(crew, ensemble, 1, first=20, attached=[False, True, True, True])
    assert crew.leader.index == 0  # the others have not heard of it yet
    run(crew, ensemble, 1, first=21, attached=[False, True, True, True])
    assert crew.leader.index == 1
    after = crew.leader.forces.message.plan  # it goes on from the plan that it received
    np.testing.assert_allclose(after.load[0, :3], plan.plan.load[0, :3], atol=1e-3)
    run(crew, ensemble, 15, first=22, attached=[False, True, True, True])
    np.testing.assert_array_equal(crew.leader.active, [False, True, True, True])
    senders = [m.sender for m in ensemble.notes.messages if m.topic == "plan"]
    assert senders[0] == 0
    assert senders[-1] == 1
    assert all(a.plan is crew.leader.forces.message for a in crew.agents)


def test_leadership_passes_over_a_bus_with_delay(make_ensemble, stack):
    e = make_ensemble(stack, delay_ms=40.0)
    crew = crew_of(e)
    run(crew, e, 60)
    run(crew, e, 60, first=60, attached=[False, True, True, True])
    assert crew.leader.index == 1
    assert all(a.faulty == {0} for a in crew.agents)
    run(crew, e, 20, first=120, attached=[False, True, True, True])
    assert all(a.plan is crew.leader.forces.message for a in crew.agents)
    np.testing.assert_array_equal(crew.agents[3].plan.plan.active, [False, True, True, True])


def test_when_all_are_faulty_the_last_leader_keeps_the_role(ensemble):
    crew = crew_of(ensemble)
    run(crew, ensemble, 20)
    run(crew, ensemble, 15, first=20, attached=[False] * 4)
    assert 0 <= crew.leader.index < 4
    assert not crew.leader.active.any()
    assert crew.leader.phase is Phase.SAFE
    assert not any("plan" in m.topic for m in ensemble.notes.messages if m.sent_us > 42_000)


@pytest.mark.parametrize("dead", [0, 2])
def test_rotors_that_give_nothing_are_a_fault_within_a_tenth_of_a_second(ensemble, dead):
    crew = crew_of(ensemble)
    run(crew, ensemble, 20)
    acts = run(crew, ensemble, 50, first=20, dead=[dead])
    assert all(a.faulty == {dead} for a in crew.agents)
    assert acts[dead].release
    np.testing.assert_array_equal(acts[dead].rotor_cmd, 0.0)
    assert not any(a.release for i, a in enumerate(acts) if i != dead)


@pytest.mark.parametrize("loss", [0.2, 0.5])
def test_over_a_bus_that_loses_messages_everyone_soon_has_order_and_plan(
    make_ensemble, stack, loss
):
    e = make_ensemble(stack, delay_ms=20.0, loss=loss)
    crew = crew_of(e)
    run(crew, e, 250)
    run(crew, e, 1, first=250)
    for agent in crew.agents[1:]:
        assert agent.order.phase == crew.leader.order.phase
        age_us = crew.leader.forces.message.stamp_us - agent.plan.stamp_us
        assert age_us <= 750_000  # at most one plan behind


@pytest.mark.parametrize("lost", [0, 2])
def test_a_fault_that_is_lost_on_its_way_arrives_with_a_heartbeat(make_ensemble, stack, lost):
    e = make_ensemble(stack, delay_ms=20.0, loss=0.5)
    crew = crew_of(e)
    run(crew, e, 60)
    loose = [i != lost for i in range(4)]
    run(crew, e, 150, first=60, attached=loose)
    assert all(a.faulty == {lost} for a in crew.agents)
    np.testing.assert_array_equal(crew.leader.active, loose)
    assert [m.topic for m in e.notes.messages].count("fault") == 1


def test_who_hears_of_a_loss_before_the_leader_s_plan_flies_on_without_the_lost(
    make_ensemble, stack
):
    e = make_ensemble(stack, delay_ms=40.0)
    crew = crew_of(e)
    run(crew, e, 60)
    loose = [True, True, False, True]
    run(crew, e, 21, first=60, attached=loose)
    assert crew.agents[3].faulty == {2}
    assert crew.agents[3].plan.plan.active[2]  # the leader's next plan is still on its way
    acts = run(crew, e, 1, first=81, attached=loose)
    np.testing.assert_array_equal(
        acts[3].force_W,
        crew.agents[3]
        ._tracking.command(
            3, e.estimate(162_000, attached=loose), crew.agents[3]._makeshift.plan, 1.0
        )
        .force_W[3],
    )


@dataclass
class Radio:
    """A bus over which one vehicle is not heard, hears nothing, or both, from a time on."""

    bus: object
    vehicle: int
    from_us: int
    mute: bool = True
    deaf: bool = False
    until_us: int = 10**12

    def publish(self, topic, sender, t_us, payload):
        off = self.mute and self.from_us <= t_us < self.until_us
        if not (off and sender == self.vehicle):
            self.bus.publish(topic, sender, t_us, payload)

    def receive(self, receiver, t_us):
        messages = self.bus.receive(receiver, t_us)
        off = self.deaf and self.from_us <= t_us < self.until_us
        return [] if off and receiver == self.vehicle else messages


CUT_OFF = [(True, False), (False, True), (True, True)]
CUT_US = 40_000


def cut_off(e, vehicle, mute, deaf, **times):
    return replace(e, bus=Radio(e.bus, vehicle, CUT_US, mute, deaf, **times))


@pytest.mark.parametrize(("mute", "deaf"), CUT_OFF)
def test_a_leader_that_is_cut_off_is_followed_by_the_lowest_vehicle_that_is_heard(
    ensemble, mute, deaf
):
    e = cut_off(ensemble, 0, mute, deaf)
    crew = crew_of(e)
    run(crew, e, (CUT_US + SILENT_US) // STEP_US - 11)
    assert crew.leader.index == 0
    run(crew, e, 33, first=(CUT_US + SILENT_US) // STEP_US - 11)
    assert crew.leader.index == 1
    assert [a.chief for a in crew.agents[1:]] == [1, 1, 1]
    assert crew.agents[0].chief is None  # by its own account it leads no longer
    assert [t.cause for t in e.notes.triggers].count("leader") == 1
    heard = crew.agents[1:] if deaf else crew.agents
    assert all(a.plan is crew.leader.forces.message for a in heard)
    assert all(a.order is crew.leader.order for a in heard)
    assert crew.leader.active.all()  # who is cut off still carries


@pytest.mark.parametrize(("mute", "deaf"), CUT_OFF)
def test_a_follower_that_is_cut_off_carries_on_and_the_leader_stays(ensemble, mute, deaf):
    e = cut_off(ensemble, 2, mute, deaf)
    crew = crew_of(e)
    acts = run(crew, e, 400)
    assert crew.leader.index == 0
    assert not any(a.faulty for a in crew.agents)
    assert not acts[2].release
    others = np.delete([np.linalg.norm(a.force_W) for a in acts], 2)
    assert np.linalg.norm(acts[2].force_W) == pytest.approx(others.mean(), rel=0.05)


def test_with_a_delay_the_role_passes_once_too(make_ensemble, stack):
    e = cut_off(make_ensemble(stack, delay_ms=40.0), 0, True, False)
    crew = crew_of(e)
    run(crew, e, 400)
    assert crew.leader.index == 1
    assert [t.cause for t in e.notes.triggers].count("leader") == 1


def test_a_leader_that_is_heard_again_leads_again(ensemble):
    e = cut_off(ensemble, 0, True, True, until_us=800_000)
    crew = crew_of(e)
    run(crew, e, 399)
    assert crew.leader.index == 1
    run(crew, e, 20, first=399)
    assert crew.leader.index == 0
    assert [t.cause for t in e.notes.triggers].count("leader") == 2
    run(crew, e, 20, first=419)
    assert all(a.plan is crew.leader.forces.message for a in crew.agents)
    assert all(a.order is crew.leader.order for a in crew.agents)


def test_who_hears_nobody_flies_on_beyond_the_plan_and_lets_go_when_the_load_is_led_away(ensemble):
    e = cut_off(ensemble, 2, True, True)
    crew = crew_of(e)
    run(crew, e, 20)
    horizon = crew.agents[2].plan.plan.end_us // STEP_US
    acts = run(crew, e, 21, first=horizon + 11)
    assert not acts[2].release
    assert np.linalg.norm(acts[2].force_W) == pytest.approx(
        np.linalg.norm(acts[0].force_W), rel=0.1
    )
    acts = run(crew, e, 21, first=horizon + 32, p_WL=(0.5, 0.0, 1.5))
    assert [a.release for a in acts] == [False, False, True, False]
    assert crew.leader.active.all()  # nobody can have heard of it
    run(crew, e, 21, first=horizon + 53, p_WL=(0.5, 0.0, 1.5), attached=[True, True, False, True])
    np.testing.assert_array_equal(crew.leader.active, [True, True, False, True])


def test_when_nobody_hears_anybody_all_fly_on_along_the_reference(ensemble):
    e = ensemble
    crew = crew_of(e)
    run(crew, e, 20)
    for agent in crew.agents:
        agent._bus = Radio(e.bus, agent.index, 0, True, True)
    plan = crew.agents[2].plan.plan
    acts = run(crew, e, 5, first=plan.end_us // STEP_US + 400)
    assert not any(a.release for a in acts)
    forces = np.array([np.linalg.norm(a.force_W) for a in acts])
    np.testing.assert_allclose(forces, forces.mean(), rtol=0.05)
