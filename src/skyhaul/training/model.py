# SPDX-License-Identifier: Apache-2.0
"""The event network as a torch module: the operator of `perception.events.batch`, to be trained.

Names and shapes of its parameters are those of the weights file, see `perception.events.weights`.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from skyhaul.perception.events.weights import Head, Layer, NetworkWeights
from skyhaul.training.kernels import (
    mean_of_neighbours,
    mean_of_neighbours_back,
    running_argmax,
)
from skyhaul.training.samples import Sample


class _MeanOfNeighbours(torch.autograd.Function):  # type: ignore[misc]
    """`mean_of_neighbours` for torch."""

    @staticmethod
    def forward(ctx: Any, h: Tensor, scale: Tensor, sample: Sample) -> Tensor:  # noqa: ANN401
        ctx.save_for_backward(h, scale)
        ctx.sample = sample
        out = np.empty(h.shape, np.float32)
        edges = sample.first, sample.source, sample.offset
        mean_of_neighbours(h.detach().numpy(), scale.detach().numpy(), *edges, out)
        return torch.from_numpy(out)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor, None]:  # noqa: ANN401
        h, scale = (a.detach().numpy() for a in ctx.saved_tensors)
        g_h, g_scale = np.zeros_like(h), np.zeros_like(scale)
        edges = ctx.sample.first, ctx.sample.source, ctx.sample.offset
        g = grads[0].contiguous().numpy()
        mean_of_neighbours_back(g, h, scale, *edges, g_h, g_scale)
        return torch.from_numpy(g_h), torch.from_numpy(g_scale), None


class _Named(nn.Module):  # type: ignore[misc]
    """Parameters by the names of a part of the weights."""

    def __init__(self, part: Layer | Head) -> None:
        super().__init__()
        for name, array in vars(part).items():
            if array is not None:
                self.register_parameter(name, nn.Parameter(torch.tensor(array)))


class EventNet(nn.Module):  # type: ignore[misc]
    """Starts from given weights; shared kernels only."""

    def __init__(self, weights: NetworkWeights, *, edge_term: bool = True) -> None:
        """Take the weights over.

        Args:
            weights: Where training starts.
            edge_term: False leaves e_ij out, as the paper does: an ablation.
        """
        super().__init__()
        if weights.has_table:
            raise ValueError("weights must be shared over offsets, got a look-up table")
        self.about = weights
        self.layers = nn.ModuleList(_Named(layer) for layer in weights.layers)
        self.head = _Named(weights.head)
        self.edge_term = edge_term
        if not edge_term:
            for layer in self.layers:
                nn.init.zeros_(layer.edge).requires_grad_(False)

    def forward(self, sample: Sample) -> tuple[Tensor, Tensor]:
        """Features of the last layer (k, C) and logits of p_mover (k,)."""
        h, runs = torch.from_numpy(sample.inputs), torch.from_numpy(sample.runs)[:, None]
        mean_edge = torch.from_numpy(sample.mean_edge)
        for i, layer in enumerate(self.layers):
            mean = _MeanOfNeighbours.apply(h, layer.scale, sample)
            new = h @ layer.root + mean @ layer.mix + layer.bias
            if self.edge_term:
                new = new + mean_edge @ layer.edge
            new = torch.relu(new)
            h = torch.where(runs, new if i == 0 else h + new, 0.0)
        largest = np.empty(h.shape, np.int64)
        running_argmax(h.detach().numpy(), sample.runs, sample.cell, sample.period, largest)
        padded = torch.cat([h, torch.zeros(1, h.shape[1])])
        maximum = padded.gather(0, torch.from_numpy(largest))
        head = self.head
        z = torch.relu(maximum @ head.cell + head.cell_bias)
        return z, h @ head.event + z @ head.context + head.event_bias

    def objectness(self, z: Tensor) -> Tensor:
        """Logits of a cell's objectness after each event, (k,)."""
        logits: Tensor = z @ self.head.objectness + self.head.objectness_bias
        return logits

    def weights(self, record: dict[str, str | int | float | list[float]]) -> NetworkWeights:
        """What has been learned, with its training record."""
        layers = tuple(Layer(**_arrays(m)) for m in self.layers)
        about = self.about
        return NetworkWeights(
            about.graph, about.cell_px, about.period_us, layers, Head(**_arrays(self.head)), record
        )


def _arrays(module: nn.Module) -> dict[str, Any]:
    return {n: p.detach().numpy().copy() for n, p in module.named_parameters()}
