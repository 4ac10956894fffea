# SPDX-License-Identifier: Apache-2.0
"""A scenario file may configure the stack; what it publishes is what flies."""

import dataclasses
from importlib import resources

import pytest
import yaml

from skyhaul.errors import ConfigError
from skyhaul.mission.config import RunConfig
from skyhaul.sensors.config import SensorsConfig
from skyhaul.world.load import load_config
from skyhaul.world.scenario import STACK_KEYS, Scenario

PAPER = yaml.safe_load((resources.files("skyhaul.world") / "scenarios/paper.yaml").read_text())


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ("mission.spool_s=0", "mission: spool_s must be > 0, got 0"),
        ("mission.lift_m=-1", "mission: lift_m must be > 0, got -1"),
        ("mission.recovery_s=-1", "mission: recovery_s must be >= 0, got -1"),
        ("mission.clear_of_floor_m=5", "mission: clear_of_floor_m must be < lift_m = 0.5, got 5"),
        ("mission.trigger.sqp_iterations=0", "mission.trigger: sqp_iterations must be >= 1, got 0"),
        ("mission.trigger.dwell_s=-1", "mission.trigger: dwell_s must be >= 0, got -1"),
        ("mission.trigger.near_m=-1", "mission.trigger: near_m must be >= 0, got -1"),
        (
            "mission.trigger={kind: periodic, sqp_iterations: -3}",
            "mission.trigger: sqp_iterations must be >= 1, got -3",
        ),
        (
            "mission.trigger={kind: periodic-feedback, sqp_iterations: 0}",
            "mission.trigger: sqp_iterations must be >= 1, got 0",
        ),
        ("mission.station.settle_s=-1", "mission.station: settle_s must be >= 0, got -1"),
        (
            "mission.station.creep_max_share=-1",
            "mission.station: creep_max_share must lie in (0, 1], got -1",
        ),
        (
            "mission.station.cruise_height_m=0",
            "mission.station: cruise_height_m must be > 0, got 0",
        ),
        ("mission.replan.dwell_s=-1", "mission.replan: dwell_s must be >= 0, got -1"),
        ("mission.replan.urgent_s=-1", "mission.replan: urgent_s must be >= 0, got -1"),
    ],
)
def test_a_value_out_of_range_is_refused_with_its_key(entry, sentence):
    with pytest.raises(ConfigError) as refused:
        load_config(RunConfig, "hover", [entry])
    assert str(refused.value).startswith(f"hover: {sentence}")


def test_the_keys_of_the_stack_are_those_that_a_flight_adds_to_a_scenario():
    flight, scenario = ({f.name for f in dataclasses.fields(c)} for c in (RunConfig, Scenario))
    assert set(STACK_KEYS) == flight - scenario


def test_the_rig_that_paper_publishes_is_the_default():
    assert load_config(RunConfig, "paper").sensors == SensorsConfig()


def test_paper_publishes_place_direction_lens_and_rate_of_every_camera():
    rig, default = PAPER["sensors"]["rig"], SensorsConfig().rig
    assert [c["name"] for c in rig["cameras"]] == [c.name for c in default.cameras]
    pose = {"name", "p_BC_m", "azimuth_deg", "elevation_deg", "lens"}
    for camera in rig["cameras"]:
        assert set(camera) == pose | {"rate_hz"}
        assert set(camera["lens"]) == {"kind", "size_px", "fov_deg", "distortion"}
    assert set(rig["event_camera"]) == pose
    assert set(PAPER["sensors"]) == {"imu", "payload_imu", "load_cell", "rig"}


def test_a_file_changes_the_rig_of_the_scenario_that_it_extends(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: dark\nsensors: {rig: {event_camera: {elevation_deg: 15}}}")
    mine, dark = load_config(RunConfig, path), load_config(RunConfig, "dark")
    assert mine.sensors.rig.event_camera.elevation_deg == 15.0
    assert mine.sensors.rig.cameras == dark.sensors.rig.cameras
    assert load_config(Scenario, path).world == mine.world == dark.world


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("sensor: {}", "mine.yaml: sensor: unknown key; did you mean 'sensors'? allowed: "),
        ("sensors: 3", "mine.yaml: sensors: must be a mapping of keys, got 3"),
        ("sensors: {rigs: {}}", "mine.yaml: sensors.rigs: unknown key; did you mean 'rig'?"),
        (
            "sensors: {rig: {event_camera: {lens: {kind: pinhole}}}}",
            "mine.yaml: sensors.rig.event_camera.lens.kind: unknown value 'pinhole'; "
            "allowed: radtan, equidistant",
        ),
        (
            "sensors: {rig: {event_camera: {lens: {focal_px: [60, 60]}}}}",
            "mine.yaml: sensors.rig.event_camera.lens: give either fov_deg, or focal_px",
        ),
    ],
)
def test_mistakes_in_the_stack_are_named_by_file_and_key(tmp_path, text, sentence):
    path = tmp_path / "mine.yaml"
    path.write_text(f"extends: paper\n{text}")
    with pytest.raises(ConfigError) as caught:
        load_config(RunConfig, path)
    assert sentence in str(caught.value)


def test_a_misspelt_root_is_refused_too_where_only_the_scenario_is_loaded(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("extends: paper\nsensor: {}")
    with pytest.raises(
        ConfigError, match=r"mine.yaml: sensor: unknown key; did you mean 'sensors'"
    ):
        load_config(Scenario, path)
    with pytest.raises(ConfigError, match="sensor: unknown key; did you mean 'sensors'"):
        load_config(Scenario, "paper", ["sensor.rig=3"])
