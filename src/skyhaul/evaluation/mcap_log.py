# SPDX-License-Identifier: Apache-2.0
"""`log.mcap`: all topics, with ROS 2 schemas; written in chunks, readable after a crash."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from struct import error as StructError  # noqa: N812
from typing import IO, Any, cast

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from skyhaul.errors import FileError
from skyhaul.evaluation.ros2.cdr import Codec, codec
from skyhaul.evaluation.ros2.schema import schema_text
from skyhaul.evaluation.whole_file import WholeFile
from skyhaul.types import TimeUs

FLUSH_PERIOD_US: TimeUs = 1_000_000
"""A killed run loses at most this much of the log [us]."""


class McapLog:
    """Writes messages; each topic is registered at its first message.

    When the disk refuses a chunk (FileError), that chunk is lost and the log has no index; what
    was written before and what still fits afterwards can be read.
    """

    def __init__(self, path: Path) -> None:
        self._file = WholeFile(path)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[int, Codec]] = {}
        self._flushed_us: TimeUs = 0
        self._writer = _writer(self._file)
        self._writer.start(profile="ros2", library="skyhaul")
        self._indexed, self._closed = True, False

    def write(self, topic: str, type_name: str, t_us: TimeUs, *leaves: Any) -> None:  # noqa: ANN401
        """Log a message given as its leaves (see `ros2.cdr`), `type_name` as `package/Type`."""
        _, encoder = self._channels.get(topic) or self._register(topic, type_name)
        self.write_encoded(topic, type_name, t_us, encoder.encode(*leaves))

    def write_encoded(self, topic: str, type_name: str, t_us: TimeUs, data: bytes) -> None:
        """Log a message that is encoded already."""
        if self._file.refused:
            self._begin_anew()
        if t_us >= self._flushed_us + FLUSH_PERIOD_US:
            self.flush()
            self._flushed_us = t_us
        channel, _ = self._channels.get(topic) or self._register(topic, type_name)
        self._writer.add_message(channel, t_us * 1000, data, t_us * 1000)

    def copy(self, record: "RawRecord") -> None:
        """Log a message as another log holds it."""
        if self._file.refused:
            self._begin_anew()
        channel, _ = self._channels.get(record.topic) or self._register(
            record.topic, record.type_name
        )
        self._writer.add_message(channel, record.t_us * 1000, record.data, record.t_us * 1000)

    def flush(self) -> None:
        """Write out what came so far."""
        if self._file.refused:
            self._begin_anew()
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Write the index and close the file; nothing when it is closed."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._indexed and not self._file.refused:
                self._writer.finish()  # type: ignore[no-untyped-call]
            elif not self._file.refused:
                self.flush()
        finally:
            self._file.close()

    def _begin_anew(self) -> None:
        """Forget what was refused; there is no index for what lies before."""
        self._indexed = False
        self._schemas, self._channels = {}, {}
        self._file.refused, self._writer = False, _writer(self._file)

    def _register(self, topic: str, type_name: str) -> tuple[int, Codec]:
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.register_schema(
                type_name.replace("/", "/msg/"), "ros2msg", schema_text(type_name).encode()
            )
        channel = self._writer.register_channel(topic, "cdr", self._schemas[type_name])
        self._channels[topic] = channel, codec(type_name)
        return self._channels[topic]


def _writer(file: WholeFile) -> Writer:
    stream = cast(IO[Any], file)
    return Writer(stream, chunk_size=4 << 20, compression=CompressionType.ZSTD)


@dataclass(frozen=True, eq=False)
class LogRecord:
    """One message out of a log."""

    topic: str
    t_us: TimeUs
    message: dict[str, Any]


@dataclass(frozen=True, eq=False)
class RawRecord:
    """One message out of a log, still encoded."""

    topic: str
    type_name: str  # `package/Type`
    t_us: TimeUs
    data: bytes


def read_raw(path: Path) -> Iterator[RawRecord]:
    """All messages of a log that was closed, in order of time.

    Raises:
        FileError: when the file is missing or no MCAP file.
    """
    if not path.is_file():
        raise FileError(f"{path} does not exist; is this a run folder?")
    with path.open("rb") as stream:
        for schema, channel, message in _messages(path, stream, None):
            name = schema.name.replace("/msg/", "/")
            yield RawRecord(channel.topic, name, message.log_time // 1000, message.data)


def read_log(path: Path, topics: set[str]) -> Iterator[LogRecord]:
    """Messages of some topics, in the order of writing; what a killed run wrote is found too.

    Raises:
        FileError: when the file is missing or no MCAP file.
    """
    if not path.is_file():
        raise FileError(f"{path} does not exist; is this a run folder?")
    with path.open("rb") as stream:
        for schema, channel, message in _messages(path, stream, topics):
            decoder = codec(schema.name.replace("/msg/", "/"))
            yield LogRecord(channel.topic, message.log_time // 1000, decoder.decode(message.data))


def _messages(
    path: Path,
    stream: IO[bytes],
    topics: set[str] | None,
) -> Iterator[tuple[Schema, Channel, Message]]:
    """Through the index where there is one, else from the front until the file breaks off.

    `topics` None means all.
    """
    try:
        indexed = make_reader(stream)
        if indexed.get_summary() is not None:
            for schema, channel, message in indexed.iter_messages(topics=topics):
                assert schema is not None, "every channel of ours has a schema"
                yield schema, channel, message
            return
    except (McapError, OSError):  # too short, or its end is no index
        pass
    stream.seek(0)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in _until_broken(path, stream):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message) and _wanted(channels, record, topics):
            channel = channels[record.channel_id]
            yield schemas[channel.schema_id], channel, record


def _wanted(channels: dict[int, Channel], message: Message, topics: set[str] | None) -> bool:
    return topics is None or channels[message.channel_id].topic in topics


def _until_broken(path: Path, stream: IO[bytes]) -> Iterator[object]:
    """Records of a stream up to its end or to where it breaks off."""
    records = iter(StreamReader(stream).records)
    first = True
    while True:
        try:
            record = next(records)
        except (McapError, StopIteration, StructError) as fault:
            if first:
                raise FileError(f"{path} is not an MCAP file") from fault
            return
        first = False
        yield record
