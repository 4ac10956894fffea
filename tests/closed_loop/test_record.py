# SPDX-License-Identifier: Apache-2.0
"""`skyhaul record` from the command line to the files, with a real flight."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from skyhaul.cli.main import main
from skyhaul.evaluation.dataset.euroc import read_frames, read_table
from skyhaul.evaluation.dataset.events_file import read_events

pytestmark = pytest.mark.slow


def test_a_recorded_hover_is_whole_and_agrees_with_itself(tmp_path) -> None:
    out = tmp_path / "set"
    argv = ["record", "hover", "--dataset", "euroc", "--out", str(out), "--vehicles", "1"]
    assert main([*argv, "--set", "task.duration_s=0.5"]) == 0
    mav = out / "vehicle_1" / "mav0"
    stamps, _ = read_table(mav / "state_groundtruth_estimate0" / "data.csv")
    assert np.all(np.diff(stamps) == 2_000_000)
    assert len(read_table(mav / "imu0" / "data.csv")[0]) == len(stamps) - 1
    images = [read_frames(mav / f"cam{c}" / "data.csv") for c in range(4)]
    assert len(images[0]) == pytest.approx(stamps[-1] / 1e8, abs=1)
    assert len({tuple(t for t, _ in camera) for camera in images}) == 1, "one trigger for all"
    events = read_events(out / "vehicle_1" / "events.h5")
    assert len(events.t_us) > 100
    assert np.all(np.diff(events.t_us) >= 0)
    assert 1000 * events.t_us[-1] <= stamps[-1]
    with (out / "log.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        seen = [c.topic for _, c, _, _ in reader.iter_decoded_messages()]
    assert seen.count("/vehicle_1/front_left/image") == len(images[0])
    assert seen.count("/vehicle_1/imu") == len(stamps) - 1
    assert {"/vehicle_1/odometry", "/vehicle_1/events", "/payload/imu", "/tf_static"} <= set(seen)
    assert main([*argv, "--set", "task.duration_s=0.5"]) == 0, "all is there already"
