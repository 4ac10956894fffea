# SPDX-License-Identifier: Apache-2.0
import pytest

from skyhaul.cli.doctor import heaviest_load_kg
from skyhaul.model.team import PointPayload, RigidPayload, Team, VehicleOverride
from skyhaul.world.check import THRUST_SHARE_MAX, hover_thrusts


@pytest.mark.parametrize(
    "team",
    [
        Team(),
        Team(count=6, cable_angle_deg=35.0),
        Team(count=3, payload=PointPayload(mass_kg=0.4)),
        Team(overrides=(VehicleOverride(index=2, mass_kg=0.3, thrust_max_n=3.9),)),
    ],
)
def test_with_the_heaviest_load_one_vehicle_gives_the_most_that_a_scenario_may_ask(
    team: Team,
) -> None:
    load_kg = heaviest_load_kg(team)
    payload = (
        PointPayload(mass_kg=load_kg)
        if team.payload.kind == "point"
        else RigidPayload(mass_kg=load_kg)
    )
    heavy = Team(
        count=team.count,
        cable_angle_deg=team.cable_angle_deg,
        payload=payload,
        overrides=team.overrides,
    )
    share = hover_thrusts(heavy) / heavy.arrays().thrust_max
    assert max(share) == pytest.approx(THRUST_SHARE_MAX, abs=1e-12)
