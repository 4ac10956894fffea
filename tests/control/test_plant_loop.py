# SPDX-License-Identifier: Apache-2.0
"""Vehicle control and the geometric payload control in the plant: rotor lag, drag, slack, loss."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from skyhaul.control.failure import Rotor, ThrustMonitor
from skyhaul.control.geometric import Geometric, flat_plan
from skyhaul.control.vehicle import CableTracking
from skyhaul.model import PointPayload, RigidPayload, Team, hover_attitude
from skyhaul.perception.api import TeamEstimate
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.world.scenario import (
    AirStart,
    MapFrame,
    Room,
    Scenario,
    VehicleDies,
    Wind,
    World,
)

pytestmark = pytest.mark.slow
TRIANGLE = Team(count=3, payload=RigidPayload(mass_kg=0.278))
NODE_S = np.arange(0.0, 3.01, 0.1)


@dataclass
class PlantLoop:
    """The plant, flown along a reference; a dead vehicle is found, released, done without."""

    team: Team
    reference: object
    wind: Wind = field(default_factory=Wind)
    dies: int | None = None
    on_reference: object = None  # `ClosedLoop.start_on`, to begin in motion

    def fly(self, seconds):
        team, n = self.team, self.team.count
        room = Room(min_m=(-6.0, -6.0, 0.0), max_m=(6.0, 6.0, 8.0))
        frame = MapFrame(origin_m=(-6.0, -6.0, 0.0), size_m=(12.0, 12.0, 8.0))
        scenario = Scenario(
            team=team,
            start=AirStart(payload_m=(0.0, 0.0, 4.0)),
            world=World(room=room, map=frame, wind=self.wind),
            events=() if self.dies is None else (VehicleDies(vehicle=self.dies, at_s=1.0),),
        )
        plant = MujocoPlant(scenario, 0)
        truth = plant.truth()
        if self.on_reference is not None:
            truth = plant.set_taut(*self.on_reference(self.reference))
        tracker, monitor = CableTracking().build(team), ThrustMonitor()
        memory, watches = tracker.init(n), [monitor.init() for _ in range(n)]
        rotor = Rotor(team.vehicle.thrust_max_n, team.vehicle.motor_lag_s)
        active, plan, command, log = np.ones(n, dtype=bool), None, truth.rotor_thrust, []
        for k in range(round(seconds / 2e-3)):
            thrust = truth.rotor_thrust.sum(axis=1)
            estimate = TeamEstimate(
                truth.stamp_us,
                truth.team,
                truth.cables,
                truth.attached,
                thrust,
                np.zeros((12, 12)),
            )
            seen = [
                monitor.step(watches[i], command[i].sum(), thrust[i], rotor, 2e-3) for i in range(n)
            ]
            watches = [s[0] for s in seen]
            lost = np.array([s[1] for s in seen]) & active
            for i in np.flatnonzero(lost):
                plant.release_hook(int(i))
            active = active & ~lost
            if plan is None or lost.any() or k % 500 == 0:
                plan = self._plan(truth.stamp_us, active)
            memory, out = tracker.step(memory, estimate, plan, np.zeros(n))
            command = out.rotor_cmd
            goal = self.reference.sample(np.array([truth.stamp_us])).p_WD[0, 0]
            log.append(
                [
                    truth.stamp_us * 1e-6,
                    np.linalg.norm(truth.team.p_WL - goal),
                    truth.cables.tension[active].min(),
                    truth.rotor_thrust.sum(axis=1).max(),
                ]
            )
            truth = plant.step(command)
        return np.array(log).T, truth, active

    def _plan(self, t_us, active):
        sample = self.reference.sample(t_us + 1e6 * NODE_S)
        R = np.zeros_like(sample.R_WD)
        R[:, 0] = hover_attitude(self.team, active)
        return flat_plan(self.team, t_us, NODE_S, (sample.p_WD, R), active, Geometric())


def rmse_mm(t, error, after_s):
    return 1e3 * np.sqrt(np.mean(error[t >= after_s] ** 2))


@pytest.mark.parametrize(("period_s", "bar_mm"), [(10.0, 10.0), (5.0, 25.0)])
def test_circles_stay_within_their_bars(closed_loop, references, period_s, bar_mm):
    circle = references[0](period_s=period_s, height_m=4.0)
    loop = PlantLoop(TRIANGLE, circle, on_reference=closed_loop(TRIANGLE).start_on)
    (t, error, tension, _), _, _ = loop.fly(2.0 * period_s)
    assert rmse_mm(t, error, 0.5) <= bar_mm
    assert tension[1:].min() > 0.1


def test_steady_wind_leaves_no_steady_error(references):
    loop = PlantLoop(Team(), references[1]((0.0, 0.0, 4.0)), wind=Wind(mean_mps=(4.0, 0.0, 0.0)))
    (t, error, _, _), _, _ = loop.fly(8.0)
    assert error.max() < 0.15
    assert rmse_mm(t, error, 6.0) < 3.0


def test_turbulence_is_ridden_out(references):
    wind = Wind(mean_mps=(1.0, 1.0, 0.0), turbulence_mps=1.0)
    loop = PlantLoop(Team(), references[1]((0.0, 0.0, 4.0)), wind=wind)
    (t, error, tension, _), _, _ = loop.fly(8.0)
    assert rmse_mm(t, error, 2.0) < 40.0
    assert tension.min() > 0.1


@pytest.mark.parametrize(
    ("team", "far_m", "tilt_deg"),
    [(Team(), 0.2, 18.5), (Team(count=5), 0.05, 0.0), (Team(payload=PointPayload()), 0.2, 0.0)],
    ids=["4 to 3", "5 to 4", "point mass"],
)
def test_the_load_stays_up_when_a_vehicle_dies(references, team, far_m, tilt_deg):
    (t, error, tension, _), truth, active = PlantLoop(
        team, references[1]((0.0, 0.0, 4.0)), dies=1
    ).fly(7.0)
    assert active.sum() == team.count - 1
    assert error.max() < far_m
    assert error[-1] < 5e-3
    assert tension[t > 1.03].min() > 0.0
    q = truth.team.q_WL
    tilt = np.rad2deg(np.arccos(np.clip(1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2), -1.0, 1.0)))
    assert tilt == pytest.approx(tilt_deg, abs=0.5)


def test_the_load_stays_up_when_a_vehicle_dies_in_motion(closed_loop, references):
    circle = references[0](period_s=10.0, height_m=4.0)
    loop = PlantLoop(Team(), circle, dies=0, on_reference=closed_loop(Team()).start_on)
    (_, error, _, _), _, active = loop.fly(9.0)
    assert active.sum() == 3
    assert error.max() < 0.2
    assert error[-1] < 0.02
