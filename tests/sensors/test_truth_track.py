# SPDX-License-Identifier: Apache-2.0
"""A track gives back what it was given, bit for bit, also through a file."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from skyhaul.errors import FileError
from skyhaul.plant.mujoco_plant import MujocoPlant
from skyhaul.sensors.truth_track import TrackWriter, load_track
from skyhaul.world.load import load_config
from skyhaul.world.scenario import Scenario


def leaves(value):
    """Every array and number in a truth, as bytes, with its name."""
    if is_dataclass(value):
        return {
            f"{f.name}.{k}": v
            for f in fields(value)
            if f.name != "contacts"
            for k, v in leaves(getattr(value, f.name)).items()
        }
    if isinstance(value, tuple):
        return {f"{i}.{k}": v for i, part in enumerate(value) for k, v in leaves(part).items()}
    array = np.asarray(value)
    return {"": (array.dtype.str, array.shape, array.tobytes())}


@pytest.fixture(scope="module")
def flown():
    plant = MujocoPlant(load_config(Scenario, "paper"), 3)
    writer, truths = TrackWriter(), [plant.truth()]
    for _ in range(2100):  # more than one chunk
        truths.append(plant.step(plant.truth().rotor_thrust * 1.02))
    for truth in truths:
        writer.add(truth)
    return truths, writer.track()


def test_a_track_gives_back_every_truth_bit_for_bit(flown) -> None:
    truths, track = flown
    assert len(track) == len(truths)
    for k, truth in enumerate(track.truths()):
        assert leaves(truth) == leaves(truths[k])
    assert track.t_us.tolist() == [t.stamp_us for t in truths]


def test_kernels_see_the_same_types_live_and_in_replay(flown) -> None:
    truths, track = flown
    for a, b in zip(track.truth(5).obstacles, truths[5].obstacles, strict=True):
        assert a.flags.writeable == b.flags.writeable
        assert a.flags.c_contiguous == b.flags.c_contiguous


def test_a_track_survives_its_file(flown, tmp_path) -> None:
    truths, track = flown
    track.save(tmp_path / "track.npz")
    again = load_track(tmp_path / "track.npz")
    assert leaves(again.truth(2000)) == leaves(truths[2000])
    assert [p.name for p in tmp_path.iterdir()] == ["track.npz"]


def test_what_is_no_track_is_refused(tmp_path) -> None:
    with pytest.raises(FileError, match="no such file"):
        load_track(tmp_path / "none.npz")
    (tmp_path / "half.npz").write_bytes(b"PK\x03\x04 half")
    with pytest.raises(FileError, match="no track of a flight"):
        load_track(tmp_path / "half.npz")
    with pytest.raises(FileError, match="nothing was recorded"):
        TrackWriter().track()
    with pytest.raises(FileError, match="cannot be written"):
        TrackWriter.track(_with_one()).save(tmp_path / "absent" / "track.npz")


def _with_one() -> TrackWriter:
    writer = TrackWriter()
    writer.add(MujocoPlant(load_config(Scenario, "hover"), 0).truth())
    return writer
