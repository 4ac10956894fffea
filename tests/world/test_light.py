# SPDX-License-Identifier: Apache-2.0
"""Light over time."""

import pytest

from skyhaul.world.load import load_config
from skyhaul.world.scenario import Light, LightChange, Scenario


def test_light_ramps_from_level_to_level_and_stays():
    light = Light(
        level=1.0,
        changes=(LightChange(at_s=2.0, level=0.2, ramp_s=1.0), LightChange(at_s=5.0, level=0.6)),
    )
    for t_s, level in {
        0.0: 1.0,
        2.0: 1.0,
        2.5: 0.6,
        3.0: 0.2,
        4.9: 0.2,
        5.0: 0.6,
        99.0: 0.6,
    }.items():
        assert light.at(t_s) == pytest.approx(level)


def test_changes_that_overlap_are_refused():
    with pytest.raises(ValueError, match="changes must not overlap: one runs from 1"):
        Light(
            changes=(
                LightChange(at_s=1.0, level=0.5, ramp_s=2.0), LightChange(at_s=2.0, level=1.0),
            )
        )  # fmt: skip
    with pytest.raises(ValueError, match="level must be >= 0"):
        Light(level=-0.1)
    with pytest.raises(ValueError, match="ramp_s must be >= 0"):
        LightChange(at_s=1.0, level=0.5, ramp_s=-1.0)


def test_in_dark_the_light_has_fallen_to_a_twentieth_after_15_s():
    light = load_config(Scenario, "dark").world.light
    assert light.at(0.0) == 1.0
    assert light.at(15.0) == pytest.approx(0.05)
