# SPDX-License-Identifier: Apache-2.0
"""Scenario files: YAML with `extends`, overrides on top, and the way back to YAML.

A file may also configure the stack that flies it. Who loads only the scenario leaves those roots,
`STACK_KEYS`, unread: they are checked where a flight is loaded.
"""

import dataclasses
import difflib
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import yaml

from skyhaul.errors import ConfigError, FileError
from skyhaul.world.check import check_scenario
from skyhaul.world.scenario import STACK_KEYS, Scenario
from skyhaul.world.schema import Tree, build, check_key, check_tree, to_tree

C = TypeVar("C")
SIZE_LIMIT_BYTES = 1_000_000
"""Largest file that is read as a scenario."""


def scenario_names() -> tuple[str, ...]:
    """Names of the scenarios that ship with the package."""
    folder = resources.files("skyhaul.world") / "scenarios"
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml")))


def load_config(cls: type[C], source: str | Path, overrides: Sequence[str] = ()) -> C:
    """A configuration from a file or a shipped scenario; later entries win.

    Precedence: defaults of `cls` < base named by `extends` < the file < overrides.

    Args:
        cls: Root parameter class: `Scenario`, or a class that extends it by roots of the stack.
        source: Name of a shipped scenario, or path of a YAML file.
        overrides: Entries `key.path=value`, the value in YAML; lists are indexed from 0, as in
            `world.obstacles[0].center_m=[1, 2, 3]`.

    Raises:
        FileError: When the file is missing, empty, binary or no YAML mapping.
        ConfigError: When its content is malformed or impossible. One sentence: file, path of the
            key, what came, what is allowed.
    """
    file = _read(str(source))
    name, tree = file.name, _resolve(cls, file, ())
    for override in overrides:
        tree = _override(tree, override)
    try:
        config = build(cls, _own(cls, tree))
        if isinstance(config, Scenario):
            check_scenario(config)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None
    return config


def dump_config(config: object) -> str:
    """The whole tree of a configuration as YAML; `load_config` makes an equal one from it."""
    text = yaml.safe_dump(
        to_tree(config), sort_keys=False, default_flow_style=None, allow_unicode=True, width=100
    )
    return str(text)


class _File(NamedTuple):
    """A scenario file that was read."""

    name: str  # as it was asked for
    text: str
    folder: Path  # where its base is looked for
    place: str  # the same for every name of the file


def _resolve(cls: type[object], file: _File, above: tuple[str, ...]) -> Tree:
    """Tree of a file on top of its base, or of the defaults; `above` are places that extend it."""
    name, tree = file.name, _parse(file.name, file.text)
    base_source = tree.pop("extends", None)
    if base_source is None:
        base = to_tree(cls())
        base["name"] = Path(name).stem
        return _merged(cls, base, tree, name)
    if not isinstance(base_source, str):
        raise ConfigError(f"{name}: extends: must name one scenario or file, got {base_source!r}")
    base_file, above = _read(base_source, file.folder), (*above, file.place)
    if base_file.place in above:
        raise ConfigError(f"{name}: extends: {base_source} leads back to itself")
    base = _resolve(cls, base_file, above)
    base["name"] = Path(name).stem
    return _merged(cls, base, tree, name)


def _merged(cls: type[object], base: Tree, tree: Tree, name: str) -> Tree:
    try:
        merged = _merge(base, _own(cls, tree))
        check_tree(cls, merged, "")
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None
    return merged


def _own(cls: type[object], tree: Tree) -> Tree:
    """The roots of a tree that are for a class; those of the stack are left to its loader."""
    own = {f.name for f in dataclasses.fields(cast(Any, cls))}
    for key in tree:
        check_key(key, own.union(STACK_KEYS), "")
    return {key: value for key, value in tree.items() if key in own}


def _merge(base: Tree, top: Tree) -> Tree:
    """Mappings merge key by key; lists, scalars and mappings of another kind replace."""
    merged = dict(base)
    for key, value in top.items():
        old = merged.get(key)
        both = isinstance(old, dict) and isinstance(value, dict)
        if both and value.get("kind", old.get("kind")) == old.get("kind"):  # type: ignore[union-attr]
            merged[key] = _merge(old, value)  # type: ignore[arg-type]
        else:
            merged[key] = value
    return merged


def _override(tree: Tree, override: str) -> Tree:
    key, equals, text = override.partition("=")
    steps = re.findall(r"[^.\[\]]+", key)
    if not equals or not steps:
        raise ConfigError(f"--set {override}: write it as key.path=value")
    try:
        value = yaml.load(text, _Loader)
    except (yaml.YAMLError, RecursionError, ValueError):
        raise ConfigError(f"--set {override}: {text!r} is no YAML value") from None
    result: Tree = _with_entry(tree, [s.strip() for s in steps], value, override)
    return result


def _with_entry(node: Any, steps: list[str], value: object, override: str) -> Any:  # noqa: ANN401
    """A copy of the node in which the entry at the end of the steps has the value."""
    step, rest = steps[0], steps[1:]
    if isinstance(node, list):
        if not step.isdecimal() or int(step) >= len(node):
            last = f"0..{len(node) - 1}" if node else "none, the list is empty"
            raise ConfigError(f"--set {override}: no entry {step}; allowed: {last}")
        i = int(step)
        new = _with_entry(node[i], rest, value, override) if rest else value
        return [*node[:i], new, *node[i + 1 :]]
    old = node if isinstance(node, dict) else {}
    if rest:
        return {**old, step: _with_entry(old.get(step), rest, value, override)}
    if step == "kind" and value != old.get("kind"):
        return {"kind": value}
    return _merge(old, {step: value})


class _Loader(yaml.SafeLoader):
    """YAML's safe subset, without aliases, merge keys and duplicate keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:  # noqa: ANN401
        """Refuse aliases: `extends` is the way to share."""
        if self.check_event(yaml.AliasEvent):
            problem = "aliases (*name) are not allowed, write the value out"
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, problem, mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:  # noqa: ANN401
        """Refuse merge keys, keys that are lists or mappings, and a key that stands twice."""
        seen: set[str] = set()
        for key, _ in node.value:
            problem = _problem(key, seen)
            if problem:
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)


def _problem(key: yaml.Node, seen: set[str]) -> str:
    """What is wrong with a key after those that were seen in its mapping."""
    if not isinstance(key, yaml.ScalarNode):
        return "a key must be a single word, not a list or a mapping"
    if key.tag == "tag:yaml.org,2002:merge":
        return "merge keys (<<) are not allowed, write the keys out"
    return f"the key {key.value!r} stands twice" if key.value in seen else ""


def _parse(name: str, text: str) -> Tree:
    try:
        tree = yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        raise FileError(f"{name}: {line}{error.problem or error.context}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise FileError(f"{name}: no YAML: {str(error).splitlines()[0]}") from None
    if tree is None:
        raise FileError(f"{name}: the file is empty; it must be a YAML mapping")
    if not isinstance(tree, dict):
        raise FileError(f"{name}: must be a YAML mapping (key: value), got {type(tree).__name__}")
    return tree


def _read(source: str, folder: Path = Path()) -> _File:
    """A shipped scenario, or a file."""
    shipped = resources.files("skyhaul.world") / "scenarios"
    if source in scenario_names():
        text = (shipped / f"{source}.yaml").read_text("utf-8")
        return _File(source, text, Path("shipped"), f"shipped {source}")
    path = folder / source
    try:
        if not path.is_file():
            raise FileError(_no_such(source, path))
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"{source}: cannot be read: {error.strerror}") from None
    if len(data) > SIZE_LIMIT_BYTES:
        raise FileError(f"{source}: {len(data)} bytes are too many for a scenario file")
    if b"\0" in data:
        raise FileError(f"{source}: is a binary file; it must be YAML text")
    try:
        return _File(source, data.decode("utf-8"), path.parent, str(path.resolve()))
    except UnicodeDecodeError:
        raise FileError(f"{source}: is no UTF-8 text; it must be YAML text") from None


def _no_such(source: str, path: Path) -> str:
    if path.is_dir():
        return f"{source}: is a folder; give a scenario file"
    if path.suffix or "/" in source:
        return f"{source}: no such file"
    names = scenario_names()
    close = difflib.get_close_matches(source, names, n=1)
    mean = f" did you mean {close[0]!r}?" if close else ""
    return f"{source}: no such scenario or file;{mean} scenarios: {', '.join(names)}"
