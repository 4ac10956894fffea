# SPDX-License-Identifier: Apache-2.0
import h5py
import numpy as np
import pytest

from skyhaul.errors import FileError
from skyhaul.evaluation.dataset.events_file import EventsWriter
from skyhaul.evaluation.dataset.layout import EVENTS_H5
from skyhaul.perception.events.recordings import read_calibration, read_rate, read_recording
from skyhaul.sensors.api import EventReading
from skyhaul.sensors.truth_api import EventLabels


def event_stream(rows, width=32, height=24):
    """An Event Stream file's bytes from rows (t, x, y from below, on)."""
    out, now = bytearray(b"Event Stream" + bytes([2, 0, 0, 1])), 0
    out += width.to_bytes(2, "little") + height.to_bytes(2, "little")
    for t, x, y, on in rows:
        overflows, rest = divmod(t - now, 127)
        out += b"\xff" * overflows + bytes([2 * rest + on])
        out += x.to_bytes(2, "little") + y.to_bytes(2, "little")
        now = t
    return bytes(out)


ROWS = [(0, 1, 0, 1), (126, 2, 1, 0), (253, 3, 2, 1), (1000, 4, 3, 0), (100_000, 31, 23, 1)]


def test_event_stream_is_read_with_y_down(tmp_path):
    (tmp_path / "a.es").write_bytes(event_stream(ROWS))
    made = read_recording(tmp_path / "a.es")
    t, x, y, on = np.array(ROWS).T
    assert (made.width, made.height) == (32, 24)
    np.testing.assert_array_equal(made.events.t_us, t)
    np.testing.assert_array_equal(made.events.x, x)
    np.testing.assert_array_equal(made.events.y, 23 - y)
    np.testing.assert_array_equal(made.events.p, 2 * on - 1)


def test_text_is_read_in_microseconds(tmp_path):
    (tmp_path / "a.txt").write_text("0.5 3 4 0\n0.500001 5 6 1\n1.25 7 2 1\n")
    events = read_recording(tmp_path / "a.txt").events
    np.testing.assert_array_equal(events.t_us, [500_000, 500_001, 1_250_000])
    np.testing.assert_array_equal(events.x, [3, 5, 7])
    np.testing.assert_array_equal(events.y, [4, 6, 2])
    np.testing.assert_array_equal(events.p, [-1, 1, 1])


def test_what_was_recorded_is_read_back(tmp_path):
    rng, n = np.random.default_rng(0), 500
    wrote = EventReading(
        np.sort(rng.integers(0, 10**6, n)), rng.integers(0, 40, n).astype(np.int16),
        rng.integers(0, 30, n).astype(np.int16), rng.choice([-1, 1], n).astype(np.int8),
    )  # fmt: skip
    file = EventsWriter(tmp_path, (64, 48))
    file.add(wrote, EventLabels(np.zeros(n, np.int16)))
    file.close()
    made = read_recording(tmp_path / EVENTS_H5)
    assert (made.width, made.height) == (64, 48)
    for column in ("t_us", "x", "y", "p"):
        np.testing.assert_array_equal(getattr(made.events, column), getattr(wrote, column))


def test_hdf5_without_events_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["images"] = np.zeros(3)
    with pytest.raises(FileError, match=r"no events in HDF5 as `skyhaul record` or DSEC"):
        read_recording(tmp_path / "a.h5")


def test_a_real_event_stream_has_the_events_that_other_readers_find(data):
    made = read_recording(data / "events" / "dvs.es")
    assert len(made.events.t_us) == 473_225
    assert (made.width, made.height) == (320, 240)
    assert (made.events.t_us[0], made.events.t_us[-1]) == (0, 999_000)
    faery = pytest.importorskip("faery", reason="faery is not installed")
    other = faery.events_stream_from_file(data / "events" / "dvs.es").to_array()
    np.testing.assert_array_equal(made.events.t_us, other["t"])
    np.testing.assert_array_equal(made.events.x, other["x"])
    np.testing.assert_array_equal(made.events.y, other["y"])
    np.testing.assert_array_equal(made.events.p > 0, other["on"])


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("a.txt", b"", "empty"),
        ("a.txt", b"\n\n", "empty"),
        ("a.txt", b"hello world\n", "no `t x y p` text"),
        ("a.txt", b"1 2 3\n", "3 numbers a line"),
        ("a.txt", b"1 2 3 4\n", "p must be 0 or 1"),
        ("a.txt", b"1 2.5 3 1\n", "whole"),
        ("a.txt", b"nan 2 3 1\n", "whole"),
        ("a.txt", b"1 -2 3 1\n", "whole"),
        ("a.txt", b"1 2 3 1\n0.5 2 3 1\n", "times fall at line 2"),
        ("a.bin", bytes(range(256)), "binary"),
        ("a.txt", b"\xff\xfe1 2\n", "no `t x y p` text"),
        ("a.es", b"Event Stream\x02\x00", "version 2"),
        ("a.es", event_stream(ROWS)[:-2], "cut off"),
        ("a.es", event_stream([(0, 40, 3, 1)]), "damaged"),
        ("a.es", event_stream([]), "holds no events"),
        ("a.es", event_stream(ROWS).replace(b"\x02\x00\x00\x01", b"\x02\x00\x00\x03", 1), "DVS"),
    ],
)
def test_a_file_without_events_is_refused_with_the_reason(tmp_path, name, content, part):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FileError) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)
    assert part in str(caught.value)


def test_files_beside_the_events(tmp_path):
    (tmp_path / "calib.txt").write_text("200 199 120 90 -0.3 0.1 1e-4 2e-4 0\n")
    (tmp_path / "motion.txt").write_text("0.1 -0.2 0.3\n")
    model = read_calibration(tmp_path / "calib.txt", (240, 180))
    assert (model.size_px, model.focal_px) == ((240, 180), (200.0, 199.0))
    assert (model.center_px, model.distortion) == ((120.0, 90.0), (-0.3, 0.1, 1e-4, 2e-4))
    np.testing.assert_array_equal(read_rate(tmp_path / "motion.txt"), [0.1, -0.2, 0.3])


@pytest.mark.parametrize("content", ["", "1 2", "a b c d", "200 199 120 90 0 0 0 0 0.1", "0 1 2 3"])
def test_a_wrong_calibration_is_refused(tmp_path, content):
    (tmp_path / "calib.txt").write_text(content)
    with pytest.raises(FileError, match=r"calib\.txt"):
        read_calibration(tmp_path / "calib.txt", (240, 180))


def test_missing_files_are_named(tmp_path):
    for read in (read_recording, read_rate, lambda p: read_calibration(p, (2, 2))):
        with pytest.raises(FileError, match=r"gone\.txt: no such file"):
            read(tmp_path / "gone.txt")
