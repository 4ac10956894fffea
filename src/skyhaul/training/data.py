# SPDX-License-Identifier: Apache-2.0
"""Scenes on disk: made when first asked for, read the next time."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from skyhaul.training.flights import HELD_OUT_FLIGHTS, TRAINING_FLIGHTS, Flight, flight
from skyhaul.training.scenes import (
    LabelledStream,
    SceneRecipe,
    load_stream,
    save_stream,
    scene_stream,
)

Part = Literal["train", "test"]
_SEEDS = {"train": 0, "test": 100_000}


@dataclass(eq=False)
class SceneSet:
    """Scenes of one seed in a folder; they take turns over the flights."""

    folder: Path
    seed: int = 0
    recipe: SceneRecipe = field(default_factory=SceneRecipe)
    flights: dict[str, Flight] = field(default_factory=dict)

    def names(self, part: Part) -> tuple[str, ...]:
        """Flights that a part's scenes are seen from."""
        return TRAINING_FLIGHTS if part == "train" else HELD_OUT_FLIGHTS

    def flight(self, name: str) -> Flight:
        """A flight, flown once."""
        if name not in self.flights:
            self.flights[name] = flight(name, self.seed, self.folder / "flights")
        return self.flights[name]

    def stream(self, part: Part, i: int) -> LabelledStream:
        """Scene i of a part."""
        path = self.folder / f"{part}-{self.seed}" / f"{i:04d}.npz"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            names = self.names(part)
            seed = 1_000_000 * self.seed + _SEEDS[part] + i
            save_stream(scene_stream(self.flight(names[i % len(names)]), self.recipe, seed), path)
        return load_stream(path)
