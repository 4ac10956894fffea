# SPDX-License-Identifier: Apache-2.0
import io

import numpy as np
import pytest
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

from skyhaul.errors import FileError
from skyhaul.evaluation import messages
from skyhaul.evaluation.ros2.cdr import codec
from skyhaul.evaluation.ros2.schema import fields, schema_text

STANDARD = (
    "builtin_interfaces/Duration",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/TransformStamped",
    "nav_msgs/Odometry",
    "nav_msgs/Path",
    "sensor_msgs/CompressedImage",
    "tf2_msgs/TFMessage",
    "visualization_msgs/Marker",
    "visualization_msgs/MarkerArray",
)


def decoded_by_others(type_name: str, data: bytes) -> object:
    """What the decoder of mcap_ros2 reads, from our schema text."""
    output = io.BytesIO()
    writer = Writer(output)
    writer.start()
    name = type_name.replace("/", "/msg/")
    schema_id = writer.register_schema(name, "ros2msg", schema_text(type_name).encode())
    writer.finish()
    from mcap.records import Schema

    schema = Schema(schema_id, schema_text(type_name).encode(), "ros2msg", name)
    decoder = DecoderFactory().decoder_for("cdr", schema)
    assert decoder is not None
    return decoder(data)


@pytest.mark.parametrize("type_name", STANDARD)
def test_standard_messages_have_the_fields_of_ros_2(type_name: str) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    package, name = type_name.split("/")
    theirs = store.get_msgdef(f"{package}/msg/{name}").fields
    assert [f.name for f in fields(type_name)] == [field[0] for field in theirs]


def test_odometry_is_encoded_byte_for_byte_as_another_library_does() -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    ours = codec("nav_msgs/Odometry").encode(
        -3, 7, "world", "payload", *range(7), np.arange(36.0), *range(10, 16), np.ones(36)
    )
    message = store.deserialize_cdr(ours, "nav_msgs/msg/Odometry")
    assert bytes(store.serialize_cdr(message, "nav_msgs/msg/Odometry")) == ours
    assert message.pose.pose.orientation.w == 6.0


def test_decoding_gives_back_what_was_encoded() -> None:
    waypoints = np.arange(9.0).reshape(3, 3).tolist()
    data = codec("skyhaul_msgs/Replan").encode(
        1, 2, "world", "start", "ok", "found", True, False, 0.5, 77, waypoints, 3.25
    )
    m = codec("skyhaul_msgs/Replan").decode(data)
    assert m["header"] == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "world"}
    assert (m["cause"], m["status"], m["accepted"], m["reaches_goal"]) == ("start", "ok", 1, 0)
    assert [list(p.values()) for p in m["waypoints"]] == waypoints
    assert (m["wait_s"], m["expanded"], m["wall_ms"]) == (0.5, 77, 3.25)


@pytest.mark.parametrize("name", ["", "a", "ab", "abc", "abcd", "vehicle 7", "Größe"])
def test_alignment_holds_after_strings_of_any_length(name: str) -> None:
    stages, cpu_s = [name, "x" * 5, name], np.array([0.1, 0.2, 0.3])
    data = codec("skyhaul_msgs/Outcome").encode(0, 0, name, True, name, 2.5, stages, cpu_s)
    mine = codec("skyhaul_msgs/Outcome").decode(data)
    theirs = decoded_by_others("skyhaul_msgs/Outcome", data)
    assert mine["stages"] == theirs.stages == stages
    np.testing.assert_array_equal(mine["cpu_s"], cpu_s)
    np.testing.assert_array_equal(theirs.cpu_s, cpu_s)
    assert mine["wall_s"] == theirs.wall_s == 2.5


@pytest.mark.parametrize("count", [0, 1, 3])
def test_sequences_of_messages_and_of_scalars_of_any_length(count: int) -> None:
    directions = np.arange(3.0 * count).reshape(count, 3).tolist()
    values, flags = np.linspace(0.0, 1.0, count), np.arange(count) % 2 == 0
    data = codec("skyhaul_msgs/CableStates").encode(
        5, 6, "world", directions, values, 2.0 * values, flags
    )
    theirs = decoded_by_others("skyhaul_msgs/CableStates", data)
    assert [[d.x, d.y, d.z] for d in theirs.direction] == directions
    np.testing.assert_array_equal(theirs.tension_n, 2.0 * values)
    np.testing.assert_array_equal(theirs.attached, flags)
    np.testing.assert_array_equal(codec("skyhaul_msgs/CableStates").decode(data)["attached"], flags)


@pytest.mark.parametrize("name", ["a", "payload", "vehicle_0"])
def test_a_stencil_fills_in_what_encoding_anew_would_give(name: str) -> None:
    def odometry(numbers: list[float]) -> tuple:  # type: ignore[type-arg]
        head = (*map(int, numbers[:2]), "world", name, *numbers[2:9])
        return (*head, np.arange(36.0), *numbers[9:15], -np.arange(36.0))

    one, other = list(np.arange(15.0)), list(np.linspace(7.0, -3.0, 15))
    one[:2], other[:2] = (3, 4), (5, 600)
    message = codec("nav_msgs/Odometry")
    assert message.stencil(*odometry(one)).fill(other) == message.encode(*odometry(other))
    tree = codec("tf2_msgs/TFMessage")
    frames, later = ([odometry(x)[:11] for x in pair] for pair in ([one, other], [other, one]))
    assert tree.stencil(frames).fill([*other[:9], *one[:9]]) == tree.encode(later)


@pytest.mark.parametrize("name", ["a", "ab", "payload"])
def test_a_stencil_of_two_messages_changes_only_where_they_differ(name: str) -> None:
    def markers(t_us: int, x: float, y: float) -> list[messages.Leaves]:
        at, size, color = (x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), (1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 1.0)
        return [messages.marker(t_us, name, 7, 5, at, size, color, ((1.0, y, -1.0), (x, x, x)))]

    message = codec("visualization_msgs/MarkerArray")
    one, other = markers(0, 0.0, 0.0), markers(1_000_001, 1.0, 2.0)
    stencil = message.stencil(one, other=(other,))
    later = message.encode(markers(8_000_009, -3.0, 4.0))
    assert stencil.fill([8, 9000, -3.0, 4.0, -3.0, -3.0, -3.0]) == later


def test_a_wrong_number_of_leaves_is_refused() -> None:
    with pytest.raises(TypeError, match="has 5 leaves, got 2"):
        codec("skyhaul_msgs/Trigger").encode(1, 2)


def test_a_fixed_array_of_wrong_length_is_refused() -> None:
    with pytest.raises(TypeError, match="array of 36 was expected, got 35"):
        codec("nav_msgs/Odometry").encode(
            0, 0, "", "", *range(7), np.zeros(35), *range(6), np.zeros(36)
        )


def test_an_unknown_message_is_one_sentence() -> None:
    with pytest.raises(FileError, match="no definition of the message 'a_msgs/B'"):
        codec("a_msgs/B")
