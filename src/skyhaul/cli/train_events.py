# SPDX-License-Identifier: Apache-2.0
"""`skyhaul train-events`: fly scenes, train the event network, judge it on other flights."""

import argparse
import sys
from importlib.util import find_spec

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from skyhaul.errors import ConfigError, FileError
from skyhaul.perception.events.weights import save_weights


class TrainingBar:
    """What is done and how far; a line for every tenth where the output is no terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = Progress(
            TextColumn("[bold]{task.description}"),
            BarColumn(bar_width=28),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[word]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", word="")
        self._shown = ("", -1)

    def __enter__(self) -> "TrainingBar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def update(self, what: str, done: int, total: int, word: str) -> None:
        """Show how far one part of the work is."""
        self._bar.update(self._task, description=what, completed=done, total=total, word=word)
        tenth = 10 * done // max(total, 1)
        if self._bar.disable and self._shown != (what, tenth):
            self._shown = what, tenth
            self._console.print(f"{what}: {done} of {total}  {word}", highlight=False)


def train_events(args: argparse.Namespace) -> int:
    """Train; writes the weights file and prints how good it is.

    Raises:
        ConfigError: When torch is missing or a number is out of range.
        FileError: When the file cannot be written.
    """
    if find_spec("torch") is None:
        raise ConfigError(
            "train-events needs torch, which nothing else does; install it with "
            "pip install 'skyhaul[train]'"
        )
    from skyhaul.training.data import SceneSet
    from skyhaul.training.train import Recipe, train

    try:
        recipe = Recipe(
            seed=args.seed, scenes=args.scenes, held_out=args.held_out, updates=args.updates,
            edge_term=not args.no_edge_term,
        )  # fmt: skip
    except ValueError as error:
        raise ConfigError(str(error)) from error
    try:
        args.work.mkdir(parents=True, exist_ok=True)
        with TrainingBar(Console(file=sys.stderr)) as bar:
            trained = train(recipe, SceneSet(args.work, args.seed), args.work, bar.update)
        save_weights(trained.weights, args.out)
    except OSError as error:
        raise FileError(f"{error.filename}: cannot be written: {error.strerror}") from error
    e, found = trained.held_out.events, trained.held_out
    print(
        f"{args.out}: {args.out.stat().st_size / 1e3:.0f} kB; held-out scenes: precision "
        f"{e.precision:.3f}, recall {e.recall:.3f}, F1 {e.f1:.3f} per event; F1 "
        f"{found.object_f1:.3f} per object and 50 ms; {found.false_share:.2%} of what stands "
        "called a mover's"
    )
    return 0
