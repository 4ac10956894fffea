# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import pytest

from skyhaul.errors import ConfigError, FileError, SkyhaulError
from skyhaul.params import Params
from skyhaul.world.load import dump_config, load_config, scenario_names
from skyhaul.world.scenario import AirStart, GoTo, HoverTask, Limits, Scenario


@dataclass(frozen=True, kw_only=True)
class Knob(Params):
    kind: Literal["knob"] = "knob"
    gain: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Switch(Params):
    kind: Literal["switch"] = "switch"
    on: bool = True
    mode: Literal["slow", "fast"] = "slow"


@dataclass(frozen=True, kw_only=True)
class Extended(Scenario):
    control: Knob | Switch = field(default_factory=lambda: Knob(gain=3.0))
    counts: tuple[int, ...] = ()


def load_text(tmp_path: Path, text: str, *overrides: str) -> Scenario:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return load_config(Scenario, path, overrides)


def refusal(tmp_path: Path, text: str, *overrides: str) -> str:
    """The sentence with which a file is refused; it names the file and is one line."""
    with pytest.raises(SkyhaulError) as caught:
        load_text(tmp_path, text, *overrides)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert "mine.yaml: " in sentence or sentence.startswith("--set")
    return sentence


# Precedence and merging


def test_defaults_then_base_then_file_then_overrides(tmp_path: Path) -> None:
    text = "extends: hover\ntask: {duration_s: 7}\nlimits: {a_max_mps2: 0.5}\n"
    s = load_text(tmp_path, text, "limits.a_max_mps2=0.75")
    assert s.limits == Limits(a_max_mps2=0.75)
    assert s.task == HoverTask(duration_s=7.0)
    assert s.start == load_config(Scenario, "hover").start
    assert s.team == Scenario().team
    assert s.name == "mine"


def test_a_mapping_of_another_kind_replaces_the_base(tmp_path: Path) -> None:
    s = load_text(tmp_path, "extends: hover\ntask: {kind: goto, goal_m: [1, 1, 2]}")
    assert s.task == GoTo(goal_m=(1.0, 1.0, 2.0))


def test_the_same_kind_named_again_keeps_the_base(tmp_path: Path) -> None:
    s = load_text(tmp_path, "extends: circle\ntask: {kind: circle, laps: 9}")
    assert s.task == replace(load_config(Scenario, "circle").task, laps=9)


def test_lists_are_replaced_whole(tmp_path: Path) -> None:
    text = (
        "extends: paper\nworld:\n  obstacles:\n"
        "  - {name: ball, center_m: [5, 5, 5], shape: {kind: sphere, radius_m: 0.2}}"
    )
    assert [o.name for o in load_text(tmp_path, text).world.obstacles] == ["ball"]


def test_a_base_is_found_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("extends: hover\ntask: {duration_s: 3}")
    s = load_text(tmp_path, "extends: base.yaml\nlimits: {v_max_mps: 1}")
    assert (s.task, s.limits.v_max_mps) == (HoverTask(duration_s=3.0), 1.0)


def test_files_that_extend_each_other_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("extends: mine.yaml")
    (tmp_path / "mine.yaml").write_text("extends: other.yaml")
    with pytest.raises(ConfigError, match="leads back to itself"):
        load_config(Scenario, tmp_path / "mine.yaml")


@pytest.mark.parametrize("link", ["two.yaml", "three.yaml"])
def test_a_cycle_across_folders_is_refused(tmp_path: Path, link: str) -> None:
    for name, base in (("a/one.yaml", f"../b/{link}"), ("b/two.yaml", "../a/one.yaml")):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(f"extends: {base}")
    (tmp_path / "b" / "three.yaml").symlink_to("two.yaml")
    with pytest.raises(ConfigError, match=r"^\.\./b/.*: extends: \.\./a/one.yaml leads back to it"):
        load_config(Scenario, tmp_path / "a" / "one.yaml")


def test_a_file_may_extend_one_of_its_name_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "mine.yaml").write_text("limits: {v_max_mps: 1.25}")
    assert load_text(tmp_path, "extends: base/mine.yaml").limits.v_max_mps == 1.25


def test_overrides_reach_list_entries_and_whole_branches(tmp_path: Path) -> None:
    s = load_text(
        tmp_path,
        "extends: paper",
        "world.obstacles[0].center_m[2]=2.5",
        "world.obstacles.1.shape={kind: sphere, radius_m: 0.3}",
        "start={kind: air, payload_m: [1, 1, 2]}",
        "team.azimuths_deg=null",
    )
    assert s.world.obstacles[0].center_m == (2.2, 2.2, 2.5)
    assert s.world.obstacles[1].shape.kind == "sphere"
    assert s.start == AirStart(payload_m=(1.0, 1.0, 2.0))
    assert s.team.azimuths_deg is None


def test_an_override_of_a_kind_drops_the_keys_of_the_old_kind(tmp_path: Path) -> None:
    s = load_text(tmp_path, "extends: paper", "task.kind=hover", "task.duration_s=4")
    assert s.task == HoverTask(duration_s=4.0)


def test_a_class_that_extends_the_scenario_loads_from_the_same_file(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("extends: hover\ncontrol: {gain: 2}\ncounts: [1, 2]")
    assert load_config(Extended, path).control == Knob(gain=2.0)
    assert load_config(Extended, path, ["control.kind=switch"]).control == Switch()
    assert load_config(Extended, "paper").control == Knob(gain=3.0)


@pytest.mark.parametrize("name", scenario_names())
def test_a_dump_loads_back_to_an_equal_configuration(tmp_path: Path, name: str) -> None:
    config = load_config(Extended, name, ["control.kind=switch"])
    path = tmp_path / "dump.yaml"
    path.write_text(dump_config(config))
    assert load_config(Extended, path) == config


def test_numbers_survive_a_dump_bit_for_bit(tmp_path: Path) -> None:
    values = (1e-17, 0.1 + 0.2, 12345678.901234567, 1e300)
    config = replace(Scenario(), time_limit_s=values[0])
    for value in values:
        config = replace(config, time_limit_s=value)
        path = tmp_path / "dump.yaml"
        path.write_text(dump_config(config))
        assert load_config(Scenario, path).time_limit_s == value


# Refusals: each says file, key, what came, what is allowed


def test_a_misspelt_key_is_named_with_the_closest_and_all_allowed(tmp_path: Path) -> None:
    sentence = refusal(tmp_path, "team: {cable_lenght_m: 1.0}")
    assert "team.cable_lenght_m: unknown key; did you mean 'cable_length_m'?" in sentence
    assert "allowed: azimuths_deg, cable_angle_deg," in sentence


def test_a_misspelt_key_deep_in_a_list_is_named_with_its_path(tmp_path: Path) -> None:
    text = (
        "world:\n  obstacles:\n  - {name: a, center_m: [5, 5, 5], "
        "shape: {kind: box, size_m: [1, 1, 1], jaw_deg: 3}}"
    )
    sentence = refusal(tmp_path, text)
    assert "world.obstacles[0].shape.jaw_deg: unknown key; did you mean 'yaw_deg'?" in sentence


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("team: {vehicle: {mass_kg: -1}}", "team.vehicle: mass_kg must be > 0, got -1"),
        ("team: {payload: {mass_kg: 0}}", "team.payload: mass_kg must be > 0, got 0"),
        ("team: {count: 9}", "team: count must lie in 1..8, got 9"),
        ("team: {count: 2.5}", "team.count: must be a whole number, got 2.5"),
        ("team: {count: true}", "team.count: must be a number, got True"),
        ("team: {count: [4]}", "team.count: must be a single value, got a list"),
        ("team: {cable_length_m: long}", "team.cable_length_m: must be a number, got 'long'"),
        ("team: {cable_length_m: .nan}", "team.cable_length_m: must be a finite number, got nan"),
        ("team: {cable_length_m: nan}", "team.cable_length_m: must be a finite number, got 'nan'"),
        ("time_limit_s: inf", "time_limit_s: must be a finite number, got 'inf'"),
        ("task: {goal_m: [1e400, 2, 3]}", "task.goal_m[0]: must be a finite number, got '1e400'"),
        ("limits: {v_max_mps: .inf}", "limits.v_max_mps: must be a finite number, got inf"),
        ("limits: 3", "limits: must be a mapping of keys, got 3"),
        ("limits:", "limits: must be a mapping of keys, got nothing"),
        ("world: {obstacles: {}}", "world.obstacles: must be a list, got {}"),
        ("task: {goal_m: [1, 2]}", "task.goal_m: must be a list of 3 entries, got 2"),
        ("task: {goal_m: [1, 2, x]}", "task.goal_m[2]: must be a number, got 'x'"),
        ("task: {kind: gotoo}", "task.kind: unknown kind 'gotoo'; did you mean 'goto'? allowed"),
        ("task: {kind: [1]}", "task.kind: unknown kind [1]"),
        ("start: {kind: fly-in}", "start: the key 'payload_m' is missing"),
        ("world: {obstacles: [{name: a}]}", "world.obstacles[0]: the key 'shape' is missing"),
        ("time_limit_s: 0", "time_limit_s must be > 0, got 0"),
        ("events: [{kind: vehicle-dies, vehicle: 1}]", "give exactly one of at_s and at_progress"),
        ("1: 2", "1: unknown key"),
        ("team: {separation_m: -1}", "team: separation_m must be > 0, got -1"),
        ("team: {cable_radius_m: -0.5}", "team: cable_radius_m must be > 0, got -0.5"),
        ("team: {tension_min_n: -5}", "team: tension_min_n must be >= 0, got -5"),
        ("team: {payload: {drag_ns_per_m: -3}}", "team.payload: drag_ns_per_m must be >= 0, got"),
        (
            "team: {payload: {kind: point, drag_ns_per_m: -3}}",
            "team.payload: drag_ns_per_m must be >= 0, got -3",
        ),
        (
            "team: {overrides: [{index: 1}, {index: 0}, {index: 1}]}",
            "team: overrides[2]: vehicle 1 stands twice; give it one entry",
        ),
        (
            "team: {overrides: [{index: 3, mass_kg: 0}]}",
            "team: overrides[0].mass_kg must be > 0, got 0",
        ),
        (
            "world: {map: {voxel_m: 0.001}}",
            "world.map: voxel_m = 0.001 makes 2.55e+12 voxels, which take 8.15e+04 GB of memory; "
            "at most 1e+08 are allowed: enlarge the voxels",
        ),
        (
            "world: {map: {window_m: [2, 2, 2], coarse_voxel_m: 0.01, voxel_m: 0.01}}",
            "world.map: voxel_m = 0.01 makes 2.56e+09 voxels",
        ),
        ("extends: 5", "extends: must name one scenario or file, got 5"),
        ("extends: papers", "papers: no such scenario or file; did you mean 'paper'?"),
    ],
)
def test_bad_content_is_refused_in_one_sentence(tmp_path: Path, text: str, part: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(SkyhaulError) as caught:
        load_config(Scenario, path)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_obstacle_without_kind_of_motion_is_asked_for_it(tmp_path: Path) -> None:
    text = (
        "world: {obstacles: [{name: a, center_m: [5, 5, 5], shape: {kind: sphere, radius_m: 1},"
        " motion: {speed_mps: 1}}]}"
    )
    part = "motion: the key 'kind' is missing; allowed: circle, cycle, line, static"
    assert part in refusal(tmp_path, text)


def test_a_word_outside_a_choice_is_refused_with_the_choices(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("control: {kind: switch, mode: warp}")
    with pytest.raises(ConfigError, match=r"control.mode: unknown value 'warp'; allowed: slow, fa"):
        load_config(Extended, path)


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (b"", "the file is empty"),
        (b"# nothing but a comment\n", "the file is empty"),
        (b"\x00\x01\x02\x7fELF", "is a binary file"),
        (b"\xff\xfe\xfa name", "is no UTF-8 text"),
        (b"- 1\n- 2\n", "must be a YAML mapping (key: value), got list"),
        (b"just words", "must be a YAML mapping (key: value), got str"),
        (b"team: {count: 4\nlimits: 3", "line 2: "),
        (b"name: a\nteam: {}\nname: b\n", "line 3: the key 'name' stands twice"),
        (b"team: {count: 3, count: 4}", "line 1: the key 'count' stands twice"),
        (b"a: &x [1]\nb: *x\n", "line 2: aliases (*name) are not allowed"),
        (b"name: a\n? [1, 2]\n: 3\n", "line 2: a key must be a single word, not a list"),
        (b"{a: b}: 3\n", "line 1: a key must be a single word, not a list or a mapping"),
        (b"limits: {<<: {v_max_mps: 1}}\n", "line 1: merge keys (<<) are not allowed"),
        (b"name: !!python/object:os.system {}", "could not determine a constructor"),
        (b"a: 2020-13-99\n", "no YAML"),
        (b"[" * 5000, ""),
        (b"a: " + b"x" * 1_000_001, "bytes are too many"),
    ],
)
def test_a_bad_file_is_refused_in_one_sentence(tmp_path: Path, data: bytes, part: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_bytes(data)
    with pytest.raises(FileError) as caught:
        load_config(Scenario, path)
    assert str(caught.value).startswith(f"{path}: ")
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_unknown_names_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"none\.yaml: no such file$"):
        load_config(Scenario, tmp_path / "none.yaml")
    with pytest.raises(FileError, match=r"did you mean 'circle'\? scenarios: circle, circle-fast"):
        load_config(Scenario, "circel")
    with pytest.raises(FileError, match="is a folder"):
        load_config(Scenario, tmp_path)


@pytest.mark.parametrize(
    ("override", "part"),
    [
        ("limits.v_max_mps", "write it as key.path=value"),
        ("=3", "write it as key.path=value"),
        ("world.obstacles[9].name=x", "no entry 9; allowed: 0..7"),
        ("world.obstacles.cube.name=x", "no entry cube; allowed: 0..7"),
        ("limits.v_max=1", "limits.v_max: unknown key; did you mean 'v_max_mps'?"),
        ("limits.v_max_mps.x=1", "limits.v_max_mps: must be a single value, got a mapping"),
        ("limits.v_max_mps=[", "'[' is no YAML value"),
        ("limits.v_max_mps=2020-13-99", "'2020-13-99' is no YAML value"),
        ("limits={[1]: 2}", "'{[1]: 2}' is no YAML value"),
        ("limits.v_max_mps=-1", "limits: v_max_mps must be > 0, got -1"),
    ],
)
def test_bad_overrides_are_refused_in_one_sentence(override: str, part: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(Scenario, "paper", [override])
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)
