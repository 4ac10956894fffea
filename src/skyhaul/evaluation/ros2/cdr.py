# SPDX-License-Identifier: Apache-2.0
"""CDR encoding (little endian, as ROS 2 writes it) generated from the message definitions.

A message is given as its leaves: the values of all primitive fields in the order of the
definition, those of nested messages in place. Strings are `str`; arrays and sequences of
primitives are arrays; a sequence of messages is a sequence of leaf tuples.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from skyhaul.evaluation.ros2.schema import PRIMITIVES, Field, fields

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR, little endian. Alignment counts from its end."""

Leaves = Sequence[Any]
Op = Callable[[bytearray, Leaves, int], int]
"""Appends the leaves from an index on; returns the index of the first leaf it left."""

_COUNT = tuple(struct.Struct("<" + "x" * (-k % 4) + "I") for k in range(8))
_ZEROS = bytes(8)


class Codec:
    """Encoder and decoder of one message type."""

    def __init__(self, type_name: str) -> None:
        self.type_name = type_name
        self._ops, self._n_leaves = _program(type_name)

    def encode(self, *leaves: Any) -> bytes:  # noqa: ANN401
        """Encode a message given as its leaves."""
        if len(leaves) != self._n_leaves:
            raise TypeError(f"{self.type_name} has {self._n_leaves} leaves, got {len(leaves)}")
        out = bytearray(HEADER)
        i = 0
        for op in self._ops:
            i = op(out, leaves, i)
        return bytes(out)

    def stencil(self, *leaves: Any, other: Leaves | None = None) -> "Stencil":  # noqa: ANN401
        """Encodes messages that differ from this one in their single numbers only.

        Args:
            leaves: A message.
            other: Another one; only those single numbers change in which the two differ.
        """
        out, spots = bytearray(HEADER), list[_Spot]()
        _trace(self._ops, out, leaves, other, spots)
        return Stencil(bytes(out), tuple(spots))

    def decode(self, data: bytes) -> dict[str, Any]:
        """Decode to nested dictionaries by field name; arrays come as NumPy arrays."""
        message, _ = _read_message(self.type_name, data, len(HEADER))
        return message


class _Spot(NamedTuple):
    """Where a run of single numbers stands in a message."""

    at: int
    form: struct.Struct
    n: int


@dataclass(frozen=True)
class Stencil:
    """A message whose texts, arrays and lengths are fixed; see `Codec.stencil`."""

    message: bytes
    spots: tuple[_Spot, ...]

    def fill(self, numbers: Sequence[float]) -> bytes:
        """The message with these single numbers, in the order of their leaves."""
        out, k = bytearray(self.message), 0
        for at, form, n in self.spots:
            form.pack_into(out, at, *numbers[k : k + n])
            k += n
        return bytes(out)


def _trace(
    ops: Sequence[Op], out: bytearray, leaves: Leaves, other: Leaves | None, spots: list[_Spot]
) -> None:
    """Encode, noting where runs of single numbers that change come to stand."""
    i = 0
    for op in ops:
        if isinstance(op, _Scalars):
            here = slice(i, i + op.count)
            changes = [True] * op.count
            if other is not None:
                changes = [a != b for a, b in zip(leaves[here], other[here], strict=True)]
            spots += op.runs(len(out), changes)
        if isinstance(op, _Messages):
            _put_count(out, leaves[i])
            others = [None] * len(leaves[i]) if other is None else other[i]
            for message, another in zip(leaves[i], others, strict=True):
                _trace(op.ops, out, message, another, spots)
            i += 1
        else:
            i = op(out, leaves, i)


@cache
def codec(type_name: str) -> Codec:
    """The codec of a message type, `package/Type`."""
    return Codec(type_name)


def _program(type_name: str) -> tuple[list[Op], int]:
    """Operations that encode a message, and the number of its leaves."""
    ops: list[Op] = []
    run = ""
    leaves = _leaf_fields(type_name)
    for f in leaves:
        if f.length is None and f.base in PRIMITIVES:
            run += PRIMITIVES[f.base]
            continue
        if run:
            ops.append(_Scalars(run))
            run = ""
        ops.append(_write_op(f))
    if run:
        ops.append(_Scalars(run))
    return ops, len(leaves)


def _leaf_fields(type_name: str) -> list[Field]:
    """Fields with nested single messages replaced by their own fields."""
    out: list[Field] = []
    for f in fields(type_name):
        if "/" in f.base and f.length is None:
            out.extend(_leaf_fields(f.base))
        else:
            out.append(f)
    return out


def _write_op(f: Field) -> Op:
    if "/" in f.base:
        return _Messages(f.base)
    if f.base == "string":
        return _write_string if f.length is None else _write_strings
    assert f.length is not None, "scalars are written in runs"
    return _write_array(PRIMITIVES[f.base], f.length)


def _aligned(codes: str, start: int) -> struct.Struct:
    """Format of consecutive scalars, padded as CDR wants when they begin at `start` mod 8."""
    text, at = "<", start
    for c in codes:
        size = struct.calcsize("<" + c)
        text += "x" * (-at % size) + c
        at += -at % size + size
    return struct.Struct(text)


class _Scalars:
    """Writes consecutive single numbers."""

    def __init__(self, codes: str) -> None:
        self._forms = tuple(_aligned(codes, k) for k in range(8))
        self._codes, self.count = codes, len(codes)

    def runs(self, start: int, changes: Sequence[bool]) -> list[_Spot]:
        """Where the runs of those that change stand, when the first number stands at `start`."""
        spots, k = list[_Spot](), 0
        while k < self.count:
            first = k
            while k < self.count and changes[k]:
                k += 1
            if k > first:
                at = start + _aligned(self._codes[:first], (start - 4) & 7).size
                run = _aligned(self._codes[first:k], (at - 4) & 7)
                spots.append(_Spot(at, run, k - first))
            k += 1
        return spots

    def __call__(self, out: bytearray, leaves: Leaves, i: int) -> int:
        out += self._forms[(len(out) - 4) & 7].pack(*leaves[i : i + self.count])
        return i + self.count


def _write_string(out: bytearray, leaves: Leaves, i: int) -> int:
    data = leaves[i].encode()
    out += _COUNT[(len(out) - 4) & 7].pack(len(data) + 1)
    out += data + b"\x00"
    return i + 1


def _write_strings(out: bytearray, leaves: Leaves, i: int) -> int:
    out += _COUNT[(len(out) - 4) & 7].pack(len(leaves[i]))
    for k in range(len(leaves[i])):
        _write_string(out, leaves[i], k)
    return i + 1


def _write_array(code: str, length: int) -> Op:
    dtype = np.dtype("<" + code)
    size = dtype.itemsize

    def write(out: bytearray, leaves: Leaves, i: int) -> int:
        values = np.ascontiguousarray(leaves[i], dtype=dtype)
        if length < 0:
            out += _COUNT[(len(out) - 4) & 7].pack(values.size)
        elif values.size != length:
            raise TypeError(f"an array of {length} was expected, got {values.size}")
        if values.size:
            out += _ZEROS[: (4 - len(out)) % size]
            out += values.tobytes()
        return i + 1

    return write


class _Messages:
    """Writes a sequence of messages."""

    def __init__(self, type_name: str) -> None:
        self.ops, _ = _program(type_name)

    def __call__(self, out: bytearray, leaves: Leaves, i: int) -> int:
        _put_count(out, leaves[i])
        for message in leaves[i]:
            k = 0
            for op in self.ops:
                k = op(out, message, k)
        return i + 1


def _put_count(out: bytearray, items: Sequence[Any]) -> None:
    out += _COUNT[(len(out) - 4) & 7].pack(len(items))


def _read_message(type_name: str, data: bytes, at: int) -> tuple[dict[str, Any], int]:
    out: dict[str, Any] = {}
    for f in fields(type_name):
        out[f.name], at = _read_field(f, data, at)
    return out, at


def _read_field(f: Field, data: bytes, at: int) -> tuple[Any, int]:
    if f.length is None:
        return _read_one(f.base, data, at)
    count = f.length
    if count < 0:
        count, at = _read_one("uint32", data, at)
    if f.base in PRIMITIVES:
        dtype = np.dtype("<" + PRIMITIVES[f.base])
        at += (4 - at) % dtype.itemsize if count else 0
        return np.frombuffer(data, dtype, count, at), at + count * dtype.itemsize
    items = []
    for _ in range(count):
        item, at = _read_one(f.base, data, at)
        items.append(item)
    return items, at


def _read_one(base: str, data: bytes, at: int) -> tuple[Any, int]:
    if "/" in base:
        return _read_message(base, data, at)
    if base == "string":
        size, at = _read_one("uint32", data, at)
        return data[at : at + size - 1].decode(), at + size
    code = "<" + PRIMITIVES[base]
    size = struct.calcsize(code)
    at += (4 - at) % size
    return struct.unpack_from(code, data, at)[0], at + size
