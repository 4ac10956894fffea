# SPDX-License-Identifier: Apache-2.0
"""Parameter classes against plain trees of dicts, lists and scalars, with one sentence per fault.

A tree is what YAML gives. `check_tree` finds what is misspelt or of the wrong form, `build` makes
the objects, `to_tree` takes them apart again.
"""

import dataclasses
import difflib
import math
import types
from collections.abc import Collection, Hashable
from functools import cache
from typing import (
    Annotated,
    Any,
    Literal,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import TypeAdapter, ValidationError

from skyhaul.errors import ConfigError

C = TypeVar("C")
Tree = dict[str, Any]

_EXPECTED = {
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
}


def build(cls: type[C], tree: Tree) -> C:
    """An object of a parameter class from its tree.

    Raises:
        ConfigError: When an entry is misspelt, missing, of the wrong form or out of range; the
            text begins with the path of the key.
    """
    check_tree(cls, tree, "")
    try:
        return cast(C, _adapter(cast(Hashable, cls)).validate_python(tree))
    except ValidationError as error:
        raise ConfigError(_sentence(error, tree)) from None


@cache
def _adapter(cls: Hashable) -> TypeAdapter[object]:
    return TypeAdapter(cast(Any, cls))


def to_tree(value: object) -> Any:  # noqa: ANN401  a tree has no narrower type
    """The tree of an object: dataclasses become dicts, tuples lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [f.name for f in dataclasses.fields(value)]
        return {name: to_tree(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [to_tree(v) for v in value]
    return value


def check_tree(kind: object, tree: object, path: str) -> None:
    """Refuse unknown keys, unknown kinds, wrong nesting and numbers that are not finite.

    Args:
        kind: The type that the tree is meant for.
        tree: The tree.
        path: Where the tree stands in the whole, as in `world.obstacles[1].shape`.

    Raises:
        ConfigError: With one sentence that begins with the path.
    """
    kind = _strip(kind)
    options = [t for t in _members(kind) if t is not type(None)]
    if tree is None and type(None) in _members(kind):
        return
    classes = [t for t in options if dataclasses.is_dataclass(t)]
    if classes:
        _check_object(classes, tree, path)
    elif len(options) == 1 and get_origin(_strip(options[0])) is tuple:
        _check_list(get_args(_strip(options[0])), tree, path)
    else:
        _check_scalar(options, tree, path)


def check_key(key: object, names: Collection[str], path: str) -> None:
    """Refuse a key that is none of the names.

    Raises:
        ConfigError: With the path of the key, what was likely meant, and what is allowed.
    """
    if key not in names:
        raise ConfigError(f"{_join(path, key)}: unknown key{_hint(key, names)}")


def _check_object(classes: list[Any], tree: object, path: str) -> None:
    where = _prefix(path)
    if not isinstance(tree, dict):
        raise ConfigError(f"{where}must be a mapping of keys, got {_show(tree)}")
    cls = classes[0] if len(classes) == 1 else _class_of_kind(classes, tree, path)
    names = [f.name for f in dataclasses.fields(cls)]
    for key in tree:
        check_key(key, names, path)
    required = [f.name for f in dataclasses.fields(cls) if _is_required(f)]
    for name in required:
        if name not in tree:
            raise ConfigError(f"{where}the key {name!r} is missing")
    hints = get_type_hints(cls, include_extras=True)
    for key, value in tree.items():
        check_tree(hints[key], value, _join(path, key))


def _class_of_kind(classes: list[Any], tree: Tree, path: str) -> Any:  # noqa: ANN401
    kinds = {kind: c for c in classes for kind in _kinds_of(c)}
    allowed = ", ".join(sorted(kinds))
    if "kind" not in tree:
        raise ConfigError(f"{_prefix(path)}the key 'kind' is missing; allowed: {allowed}")
    kind = tree["kind"]
    if not isinstance(kind, str) or kind not in kinds:
        raise ConfigError(f"{_join(path, 'kind')}: unknown kind {_show(kind)}{_hint(kind, kinds)}")
    return kinds[kind]


def _check_list(items: tuple[Any, ...], tree: object, path: str) -> None:
    where = _prefix(path)
    if not isinstance(tree, list | tuple):
        raise ConfigError(f"{where}must be a list, got {_show(tree)}")
    if items and items[-1] is not Ellipsis and len(tree) != len(items):
        raise ConfigError(f"{where}must be a list of {len(items)} entries, got {len(tree)}")
    for i, value in enumerate(tree):
        item = items[0] if items[-1] is Ellipsis else items[i]
        check_tree(item, value, f"{path}[{i}]")


def _check_scalar(options: list[Any], tree: object, path: str) -> None:
    where = _prefix(path)
    if isinstance(tree, dict | list | tuple) and any(o in (int, float, str, bool) for o in options):
        form = "a list" if isinstance(tree, list | tuple) else "a mapping"
        raise ConfigError(f"{where}must be a single value, got {form}")
    if isinstance(tree, bool) and bool not in options and (int in options or float in options):
        raise ConfigError(f"{where}must be a number, got {_show(tree)}")
    if isinstance(tree, float) and not math.isfinite(tree):
        raise ConfigError(f"{where}must be a finite number, got {_show(tree)}")
    literals = [v for o in options if get_origin(o) is Literal for v in get_args(o)]
    if literals and tree not in literals and len(options) == 1:
        allowed = ", ".join(str(v) for v in literals)
        raise ConfigError(f"{where}unknown value {_show(tree)}; allowed: {allowed}")


def _sentence(error: ValidationError, tree: Tree) -> str:
    """The first fault that pydantic found, as one sentence."""
    others = {
        e["loc"][:-1]
        for e in error.errors()
        if e["type"] == "literal_error" and e["loc"][-1] == "kind"
    }  # members of a union that the entry is not meant to be
    faults = [
        e
        for e in error.errors()
        if not any(e["loc"][:k] in others for k in range(1, len(e["loc"]) + 1))
    ]
    first = (faults or error.errors())[0]
    where = _prefix(_path_in(tree, first["loc"]))
    if first["type"] == "value_error":
        return where + first["msg"].removeprefix("Value error, ")
    expected = _EXPECTED.get(first["type"], first["msg"][:1].lower() + first["msg"][1:])
    return f"{where}{expected}, got {_show(first['input'])}"


def _path_in(tree: Any, loc: tuple[int | str, ...]) -> str:  # noqa: ANN401
    """Path of a fault, without the class names that pydantic puts in between."""
    path, node = "", tree
    for step in loc:
        if isinstance(step, int) and isinstance(node, list | tuple) and step < len(node):
            path, node = f"{path}[{step}]", node[step]
        elif isinstance(node, dict) and step in node:
            path, node = _join(path, str(step)), node[step]
    return path


def _members(kind: object) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def _strip(kind: object) -> object:
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    return kind


def _kinds_of(cls: Any) -> tuple[str, ...]:  # noqa: ANN401
    return get_args(get_type_hints(cls)["kind"])


def _is_required(f: "dataclasses.Field[Any]") -> bool:
    missing = dataclasses.MISSING
    return f.default is missing and f.default_factory is missing


def _hint(key: object, names: Any) -> str:  # noqa: ANN401
    close = difflib.get_close_matches(str(key), list(names), n=1)
    mean = f"; did you mean {close[0]!r}?" if close else ";"
    return f"{mean} allowed: {', '.join(sorted(names))}"


def _join(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)


def _prefix(path: str) -> str:
    return f"{path}: " if path else ""


def _show(value: object) -> str:
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
