# SPDX-License-Identifier: Apache-2.0
"""Weights of the event network: what is trained, how it is stored, how the kernels take it.

With h a row vector of C = 16 features, layer l is

    h_i' = h_i + relu(h_i @ root + mean_j [h_j @ W(dx, dy) + e_ij @ edge] + bias)

(layer 0 has the inputs of `surface.node_inputs` and no residual), where W(dx, dy) is either a
look-up table, `table[offset]`, or diag(scale[offset]) @ mix. The head takes the maximum m of h
over the events of a cell and two pooling periods, z = relu(m @ cell + cell_bias), and gives

    objectness = sigmoid(z @ objectness + objectness_bias)           of the cell
    p_mover    = sigmoid(h @ event + z @ context + event_bias)       of an event in it

Every array is named as a torch module with the same operator would name it in its state dict
(`layers.0.root`, `head.cell`), so that a trained state dict is these weights.
"""

import json
import zipfile
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skyhaul.errors import FileError
from skyhaul.perception.events.api import Float32
from skyhaul.perception.events.graph import EDGE, GraphParams, spiral
from skyhaul.perception.events.surface import INPUTS
from skyhaul.types import frozen
from skyhaul.whole import whole

WIDTH = 16
"""C: channels of every layer."""

FORMAT = 2

SHIPPED = Path(__file__).with_name("event_network.npz")
"""The weights that come with the package."""

Record = dict[str, str | int | float | list[float]]
"""How weights came about: seed, recipe of the data, curve. Free keys, plain values."""


@dataclass(frozen=True, eq=False)
class Layer:
    """One graph convolution; either `table`, or `scale` and `mix`, is there."""

    root: Float32  # (inputs, C)
    edge: Float32  # (EDGE, C)
    bias: Float32  # (C,)
    scale: Float32 | None = None  # (offsets, inputs)
    mix: Float32 | None = None  # (inputs, C)
    table: Float32 | None = None  # (offsets, inputs, C)


@dataclass(frozen=True, eq=False)
class Head:
    """Max-pool over cells and the two outputs."""

    cell: Float32  # (C, C)
    cell_bias: Float32  # (C,)
    objectness: Float32  # (C,)
    objectness_bias: Float32  # (1,)
    event: Float32  # (C,)
    context: Float32  # (C,)
    event_bias: Float32  # (1,)


@dataclass(frozen=True, eq=False)
class NetworkWeights:
    """A network: its graph, its layers, its head, and where they come from."""

    graph: GraphParams
    cell_px: int
    period_us: int
    layers: tuple[Layer, ...]
    head: Head
    record: Record

    def __post_init__(self) -> None:
        frozen(*self.arrays().values())

    @property
    def has_table(self) -> bool:
        """Whether W(dx, dy) is a look-up table."""
        return self.layers[0].table is not None

    def arrays(self) -> dict[str, Float32]:
        """Every trained array by its name."""
        named = {f"head.{f.name}": getattr(self.head, f.name) for f in fields(Head)}
        for i, layer in enumerate(self.layers):
            named |= {f"layers.{i}.{f.name}": getattr(layer, f.name) for f in fields(Layer)}
        return {name: array for name, array in named.items() if array is not None}


STACK = 2 * WIDTH + 8
"""Rows of a layer's stacked matrices: root, mix, edge, bias, and zeros."""


class PackedWeights(NamedTuple):
    """Weights as the kernels read them."""

    stack: Float32  # (L, STACK, C) root, mix (zero with tables), edge, bias, zeros
    scale: Float32  # (offsets, L * C); empty with tables
    table: Float32  # (L, offsets, C, C); empty without
    cell: Float32  # (C, C)
    cell_bias: Float32  # (C,)
    outputs: Float32  # (3, C) objectness, event, context
    output_bias: Float32  # (2,) objectness, event


def packed(weights: NetworkWeights) -> PackedWeights:
    """Weights in the kernels' layout."""
    layers, head = weights.layers, weights.head
    offsets = len(spiral(weights.graph.radius_px))
    count = len(layers)
    stack = np.zeros((count, STACK, WIDTH))
    tables, mixes = (count, 0) if weights.has_table else (0, count)
    scale, table = np.zeros((offsets, mixes, WIDTH)), np.zeros((tables, offsets, WIDTH, WIDTH))
    for i, layer in enumerate(layers):
        inputs = len(layer.root)
        stack[i, :inputs] = layer.root
        stack[i, 2 * WIDTH : 2 * WIDTH + EDGE] = layer.edge
        stack[i, 2 * WIDTH + EDGE] = layer.bias
        if layer.table is not None:
            table[i, :, :inputs] = layer.table
        if layer.mix is not None and layer.scale is not None:
            stack[i, WIDTH : WIDTH + inputs], scale[:, i, :inputs] = layer.mix, layer.scale
    rows = (stack, scale.reshape(offsets, mixes * WIDTH), table, head.cell, head.cell_bias,
            np.stack([head.objectness, head.event, head.context]),
            np.concatenate([head.objectness_bias, head.event_bias]))  # fmt: skip
    return PackedWeights(*(np.ascontiguousarray(a, dtype=np.float32) for a in rows))


def random_weights(
    graph: GraphParams, *, has_table: bool, layers: int = 4, seed: int = 0
) -> NetworkWeights:
    """Untrained weights: where training starts, and what tests use; they know no mover."""
    rng = np.random.default_rng(seed)
    offsets = len(spiral(graph.radius_px))

    def normal(*shape: int, fan_in: int) -> Float32:
        drawn: Float32 = (rng.normal(size=shape) / np.sqrt(fan_in)).astype(np.float32)
        return drawn

    made = []
    for i in range(layers):
        a = INPUTS if i == 0 else WIDTH
        fan_in = 2 * a + EDGE
        layer = Layer(
            root=normal(a, WIDTH, fan_in=fan_in),
            edge=normal(EDGE, WIDTH, fan_in=fan_in),
            bias=normal(WIDTH, fan_in=fan_in),
        )
        if has_table:
            layer = replace(layer, table=normal(offsets, a, WIDTH, fan_in=fan_in))
        else:
            scale = (1.0 + 0.5 * rng.normal(size=(offsets, a))).astype(np.float32)
            layer = replace(layer, mix=normal(a, WIDTH, fan_in=fan_in), scale=scale)
        made.append(layer)
    head = Head(
        cell=normal(WIDTH, WIDTH, fan_in=WIDTH),
        cell_bias=normal(WIDTH, fan_in=WIDTH),
        objectness=normal(WIDTH, fan_in=WIDTH),
        objectness_bias=normal(1, fan_in=WIDTH),
        event=normal(WIDTH, fan_in=2 * WIDTH),
        context=normal(WIDTH, fan_in=2 * WIDTH),
        event_bias=normal(1, fan_in=2 * WIDTH),
    )
    return NetworkWeights(graph, 16, 10_000, tuple(made), head, {"trained": 0, "seed": seed})


def save_weights(weights: NetworkWeights, path: Path) -> None:
    """Write a weights file (.npz): the arrays, and one JSON text with graph and record."""
    about = {
        "format": FORMAT,
        "graph": asdict(weights.graph),
        "cell_px": weights.cell_px,
        "period_us": weights.period_us,
        "record": weights.record,
    }
    named: dict[str, Any] = {"about": np.array(json.dumps(about)), **weights.arrays()}
    with whole(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **named)


def shipped_weights() -> NetworkWeights:
    """The weights that come with the package, made by `skyhaul train-events`."""
    return load_weights(SHIPPED)


def load_weights(path: Path) -> NetworkWeights:
    """Read a weights file.

    Raises:
        FileError: When there is none, or it is no weights file of this format.
    """
    if not path.is_file():
        raise FileError(f"{path}: no such file; give the weights of an event network (.npz)")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: no weights file (.npz) of an event network") from error
    try:
        about = json.loads(str(arrays.pop("about")))
        if about["format"] != FORMAT:
            raise FileError(f"{path}: weights of format {about['format']}, this reads {FORMAT}")
        return _weights(about, arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: weights of an event network lack or misname {error}") from error


def _weights(about: dict[str, object], arrays: dict[str, Float32]) -> NetworkWeights:
    graph = GraphParams(**about["graph"])  # type: ignore[arg-type]
    count = len({name.split(".")[1] for name in arrays if name.startswith("layers.")})
    layers = tuple(_layer(arrays, f"layers.{i}.") for i in range(count))
    head = Head(**{f.name: arrays.pop(f"head.{f.name}") for f in fields(Head)})
    if arrays:
        raise ValueError(f"nothing, but have the unknown {sorted(arrays)[0]}")
    made = NetworkWeights(
        graph, int(about["cell_px"]), int(about["period_us"]), layers, head,  # type: ignore[call-overload]
        about["record"],  # type: ignore[arg-type]
    )  # fmt: skip
    _check_shapes(made)
    return made


def _layer(arrays: dict[str, Float32], prefix: str) -> Layer:
    """Takes one layer's arrays out."""
    names = ["root", "edge", "bias"]
    names += ["table"] if prefix + "table" in arrays else ["scale", "mix"]
    return Layer(**{name: arrays.pop(prefix + name) for name in names})


def _check_shapes(weights: NetworkWeights) -> None:
    wanted = random_weights(
        weights.graph, has_table=weights.has_table, layers=len(weights.layers)
    ).arrays()
    for name, array in wanted.items():
        got = weights.arrays().get(name)
        if got is None or got.shape != array.shape:
            shape = "nothing" if got is None else got.shape
            raise ValueError(f"{name}: {shape} instead of {array.shape}")
