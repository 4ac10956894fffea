# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace

import numpy as np
import pytest

from skyhaul.errors import FileError
from skyhaul.perception.events.classifier import NetworkParams
from skyhaul.perception.events.graph import GraphParams
from skyhaul.perception.events.weights import (
    SHIPPED,
    load_weights,
    random_weights,
    save_weights,
    shipped_weights,
)

WEIGHTS = random_weights(GraphParams(window_us=15_000), has_table=False, seed=2)


@pytest.mark.parametrize("has_table", [False, True])
def test_a_file_holds_weights_graph_and_record(tmp_path, has_table):
    weights = random_weights(GraphParams(radius_px=2), has_table=has_table)
    weights = replace(weights, record={"seed": 4, "recipe": "crossing balls", "curve": [0.5, 0.25]})
    save_weights(weights, tmp_path / "w.npz")
    back = load_weights(tmp_path / "w.npz")
    assert (back.graph, back.record, back.has_table) == (weights.graph, weights.record, has_table)
    assert back.arrays().keys() == weights.arrays().keys()
    for name, array in weights.arrays().items():
        np.testing.assert_array_equal(back.arrays()[name], array)


def test_files_are_small(tmp_path):
    for has_table in (False, True):
        save_weights(random_weights(GraphParams(), has_table=has_table), tmp_path / "w.npz")
        assert (tmp_path / "w.npz").stat().st_size < 1_000_000


def test_skipping_can_be_changed_without_other_weights(tmp_path):
    save_weights(WEIGHTS, tmp_path / "w.npz")
    network = NetworkParams(weights=str(tmp_path / "w.npz"), min_neighbours=0).build()
    assert network.weights.graph == replace(WEIGHTS.graph, min_neighbours=0)


def damaged(path, change):
    """A weights file with one thing wrong."""
    save_weights(WEIGHTS, path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    change(arrays)
    np.savez(path, **arrays)


def other_format(arrays):
    arrays["about"] = np.array(json.dumps(json.loads(str(arrays["about"])) | {"format": 9}))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda a: a.pop("layers.1.root"), "layers.1.root"),
        (lambda a: a.pop("head.cell"), "head.cell"),
        (lambda a: a.update({"layers.2.bias": np.zeros(3, np.float32)}), "layers.2.bias"),
        (lambda a: a.update({"layers.0.gain": np.zeros(3)}), "unknown layers.0.gain"),
        (other_format, "format 9"),
    ],
)
def test_a_damaged_file_is_refused_with_what_is_wrong(tmp_path, change, part):
    damaged(tmp_path / "w.npz", change)
    with pytest.raises(FileError) as caught:
        load_weights(tmp_path / "w.npz")
    assert str(tmp_path / "w.npz") in str(caught.value)
    assert part in str(caught.value)


def test_no_weights_file_is_refused(tmp_path):
    (tmp_path / "text.npz").write_text("hello")
    for name in ("none.npz", "text.npz"):
        with pytest.raises(FileError, match=name):
            load_weights(tmp_path / name)


def test_the_weights_that_ship_say_how_they_were_made():
    assert SHIPPED.stat().st_size < 1_000_000
    record = shipped_weights().record
    assert record["trained"] == 1
    for key in ("seed", "scenes", "updates", "flights", "held_out_flights", "scene_recipe", "f1"):
        assert key in record, key
    curve = np.reshape(record["curve_updates_loss_f1"], (-1, 3))
    assert curve[-1, 0] == record["updates"]
    assert curve[-1, 1] < curve[0, 1]
    flown, held_out = (set(str(record[k]).split(", ")) for k in ("flights", "held_out_flights"))
    assert not flown & held_out
