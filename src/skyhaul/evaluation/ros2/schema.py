# SPDX-License-Identifier: Apache-2.0
"""ROS 2 message definitions, read from the .msg texts beside this file."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from skyhaul.errors import FileError

PRIMITIVES = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "byte": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Format character of `struct` and `numpy` for each primitive type."""

_RULE = "=" * 80


@dataclass(frozen=True)
class Field:
    """One field of a message."""

    name: str
    base: str
    """A primitive, `string`, or the full name of a message, `package/Type`."""
    length: int | None
    """None: a single value; -1: a sequence; otherwise a fixed array."""


@cache
def definition_text(type_name: str) -> str:
    """Text of one definition, `type_name` as `package/Type`.

    Raises:
        FileError: when we ship no such message.
    """
    package, _, name = type_name.partition("/")
    source = files(__package__) / "msg" / package / f"{name}.msg"
    if not source.is_file():
        raise FileError(f"no definition of the message {type_name!r} is shipped with skyhaul")
    return source.read_text(encoding="utf-8")


@cache
def fields(type_name: str) -> tuple[Field, ...]:
    """Fields of a message, in the order in which they are encoded."""
    package = type_name.partition("/")[0]
    lines = (line.partition("#")[0].split() for line in definition_text(type_name).splitlines())
    return tuple(_field(package, words) for words in lines if words and not _is_constant(words))


def schema_text(type_name: str) -> str:
    """The definition with those of all messages inside it, as MCAP's `ros2msg` encoding wants."""
    parts = [definition_text(type_name)]
    for inner in _inner_types(type_name):
        parts.append(f"{_RULE}\nMSG: {inner}\n{definition_text(inner)}")
    return "".join(parts)


def _inner_types(type_name: str) -> list[str]:
    """Every message type inside a message, each once, outer ones first."""
    found: list[str] = []
    todo = [type_name]
    while todo:
        for f in fields(todo.pop(0)):
            if "/" in f.base and f.base not in found:
                found.append(f.base)
                todo.append(f.base)
    return found


def _is_constant(words: list[str]) -> bool:
    return "=" in words[1] or (len(words) > 2 and words[2].startswith("="))


def _field(package: str, words: list[str]) -> Field:
    """Parse `type name [default]`; the type may end in [], [n] or [<=n]."""
    base, bracket, rest = words[0].partition("[")
    base = base.partition("<=")[0]
    length = None if not bracket else _length(rest.rstrip("]"))
    if base not in PRIMITIVES and base != "string" and "/" not in base:
        base = f"{package}/{base}"
    return Field(words[1], base, length)


def _length(text: str) -> int:
    return int(text) if text.isdigit() else -1
