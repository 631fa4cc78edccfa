"""One MCAP file of a stage: written once, checked to the last byte, read by index.

Time is a story, the same at every run: stage i begins 10 i seconds after ``EPOCH_NS``, and record k
of a topic stands k seconds later, which is how it is found. Records of one topic are written
together; how many there are is noted in the file's metadata. What a viewer needs beside the
records, see ``views``, has topics of its own.
"""

from __future__ import annotations

import os
import struct
import threading
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar, cast, overload

from google.protobuf.message import DecodeError
from google.protobuf.message import Message as ProtoMessage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from spinpipe.pipeline.atomic import naming
from spinpipe.schemas.topics import Topic

T = TypeVar("T")

EPOCH_NS = 1_262_304_000_000_000_000
"""2010-01-01, the year of the paper: wall-clock time would make equal runs differ."""
SECOND_NS = 1_000_000_000
STAGE_S = 10
"""Between the beginnings of two stages."""
FORMAT = "2"
"""Of stage files; part of every key, so that files of another format are made anew."""

KEPT = 16
"""Records of a topic: the tiles around a place, and those around the next one; a few megabytes each
at most."""
CHUNK_BYTES = 1 << 16
"""What a kill can cost: a chunk reaches the disk when it is full."""
_FOOTER_BYTES = 1 + 8 + 20 + 8
_DATA_END_BYTES = 1 + 8 + 4


class DamagedFileError(Exception):
    """A file that is cut short, or that is not what was written."""


class StageFileWriter:
    """Writes the messages of one stage; ``close`` makes the file complete on disk.

    Parameters
    ----------
    path : of the file.
    metadata : what it is made from.
    number : of the stage: when its story begins.
    """

    def __init__(self, path: Path, metadata: dict[str, str], number: int = 0) -> None:
        self._path = path
        self._begin_ns = EPOCH_NS + number * STAGE_S * SECOND_NS
        self._stream = path.open("wb")
        self._writer = Writer(
            cast(BinaryIO, self._stream),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.NONE,
            enable_data_crcs=True,
        )
        self._writer.start(profile="", library="spinpipe")
        self._writer.add_metadata("stage", metadata)
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._last = ""

    def declare(self, topic: Topic[T]) -> None:
        """Register a topic, so that it is in the file even without a message."""
        self._channel(topic.name, topic.proto)

    def _channel(self, name: str, proto: type[ProtoMessage]) -> int:
        if name not in self._channels:
            schema = register_schema(self._writer, proto)
            self._channels[name] = self._writer.register_channel(
                topic=name, message_encoding="protobuf", schema_id=schema
            )
        return self._channels[name]

    def write(self, topic: Topic[T], message: T) -> None:
        """Append one record; all records of a topic must be written one after the other."""
        self.write_bytes(topic, topic.encode(message).SerializeToString(deterministic=True))

    def write_bytes(self, topic: Topic[T], data: bytes) -> None:
        """Append one record that is encoded already."""
        count = self._counts.get(topic.name, 0)
        if count and self._last != topic.name:
            raise ValueError(f"{topic.name}: messages of a topic must be written together")
        self._add(self._channel(topic.name, topic.proto), count, count, data)
        self._counts[topic.name], self._last = count + 1, topic.name

    def write_view(self, name: str, seconds: int, message: ProtoMessage) -> None:
        """Append what viewers read, so long after the stage's beginning."""
        count = self._counts.get(name, 0)
        stamp(message, self._begin_ns + seconds * SECOND_NS)
        data = message.SerializeToString(deterministic=True)
        self._add(self._channel(name, type(message)), seconds, count, data)
        self._counts[name] = count + 1

    def _add(self, channel: int, seconds: int, sequence: int, data: bytes) -> None:
        time = self._begin_ns + seconds * SECOND_NS
        with naming(self._path):
            self._writer.add_message(
                channel_id=channel,
                log_time=time,
                publish_time=time,
                data=data,
                sequence=sequence,
            )
            self._stream.flush()  # what is written survives a kill: see recover()

    def close(self, metadata: dict[str, str]) -> None:
        """Write the index, flush to disk and read everything back against its checksums."""
        records = {name: str(count) for name, count in self._counts.items()}
        self._writer.add_metadata("records", {"begin_ns": str(self._begin_ns), **records})
        self._writer.add_metadata("result", metadata)
        with naming(self._path):
            self._writer.finish()
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
        require_whole(self._path)

    def abandon(self) -> None:
        """Close the file as it is: incomplete."""
        with suppress(OSError):  # a full disk has been told of already
            self._stream.close()


def stamp(message: Any, time_ns: int) -> None:
    """Set the time of one of Foxglove's messages: viewers of transforms go by it."""
    parts = [message]
    for name in ("entities", "transforms"):
        parts = getattr(message, name, parts)
    for part in parts:
        part.timestamp.CopyFrom(Timestamp(seconds=time_ns // SECOND_NS))


def check(path: Path) -> None:
    """Read a whole file against its checksums, so that no flipped bit goes unnoticed.

    Raises
    ------
    DamagedFileError
        If the file is cut short or any byte differs from what was written.
    """
    with path.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size < _FOOTER_BYTES + _DATA_END_BYTES:
            raise DamagedFileError(f"{path.name} is cut short")
        stream.seek(size - _FOOTER_BYTES)
        footer = stream.read(_FOOTER_BYTES)
        opcode, length, summary_start, _, summary_crc = struct.unpack("<BQQQI", footer[:-8])
        if opcode != 2 or length != 20 or not _DATA_END_BYTES <= summary_start < size:
            raise DamagedFileError(f"{path.name} is cut short or damaged at its end")
        if footer[-8:] != b"\x89MCAP0\r\n":
            raise DamagedFileError(f"{path.name} is damaged at its end")
        data_end = summary_start - _DATA_END_BYTES
        data_crc = _crc(stream, 0, data_end)
        opcode, length, expected = struct.unpack("<BQI", stream.read(_DATA_END_BYTES))
        if (opcode, length, expected) != (15, 4, data_crc):
            raise DamagedFileError(f"{path.name} is damaged: its data does not match its checksum")
        if _crc(stream, summary_start, size - 12) != summary_crc:
            raise DamagedFileError(f"{path.name} is damaged: its index does not match its checksum")


def require_whole(path: Path) -> None:
    """``check`` a file, once for as long as it stays as it is; whatever is read passes here.

    Raises
    ------
    DamagedFileError
        See ``check``.
    """
    _check_once(*_identity(path))


def _identity(path: Path) -> tuple[Path, int, int, int, int]:
    """What changes when a file changes."""
    stat = path.stat()
    return path.resolve(), stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns


@lru_cache(maxsize=256)
def _check_once(path: Path, *_identity: int) -> None:
    check(path)


def _crc(stream: BinaryIO, begin: int, end: int) -> int:
    stream.seek(begin)
    crc, left = 0, end - begin
    while left > 0 and (block := stream.read(min(left, 1 << 22))):
        crc = zlib.crc32(block, crc)
        left -= len(block)
    return crc


def read_metadata(path: Path, name: str) -> dict[str, str]:
    """The metadata record ``name`` of a complete file; empty if there is none.

    Raises
    ------
    DamagedFileError
        If any byte of the file is not what was written.
    """
    require_whole(path)
    return dict(_metadata(*_identity(path)).get(name, {}))


@lru_cache(maxsize=256)
def _metadata(path: Path, *_identity: int) -> dict[str, dict[str, str]]:
    """All metadata records of a whole file by name."""
    try:
        with path.open("rb") as stream:
            records = SeekingReader(stream, validate_crcs=True).iter_metadata()
            return {record.name: dict(record.metadata) for record in records}
    except (McapError, struct.error, ValueError, UnicodeDecodeError):
        raise DamagedFileError(f"{path.name} is cut short or damaged") from None


class Messages(Sequence[T], Generic[T]):
    """The records of one topic in a complete file, decoded when they are asked for.

    The last ``KEPT`` that were asked for by number are kept: neighbouring tiles are read again and
    again. Can be pickled and sent to a worker that sees the same path.
    """

    def __init__(self, path: Path, topic: Topic[T]) -> None:
        self.path = path
        self.topic = topic
        records = read_metadata(path, "records")
        try:
            self._begin_ns = int(records["begin_ns"])
            self._count = int(records.get(topic.name, "0"))
        except (KeyError, ValueError):
            raise DamagedFileError(f"{path.name} was not written by this version") from None
        self._record = lru_cache(KEPT)(self._one)

    def __reduce__(self) -> tuple[type[Messages[T]], tuple[Path, Topic[T]]]:
        return type(self), (self.path, self.topic)

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[T]: ...
    def __getitem__(self, index: int | slice) -> T | Sequence[T]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._count))]
        index = index + self._count if index < 0 else index
        if not 0 <= index < self._count:
            raise IndexError(index)
        return self._record(index)

    def __iter__(self) -> Iterator[T]:
        return self._read(0, self._count)

    def _one(self, index: int) -> T:
        return next(self._read(index, index + 1))

    def _read(self, begin: int, end: int) -> Iterator[T]:
        messages = _reader(self.path).iter_messages(
            topics=self.topic.name,
            starting_at=self._begin_ns + begin * SECOND_NS,
            ending_before=self._begin_ns + end * SECOND_NS,
        )
        try:
            for _, _, message in messages:
                yield self.topic.decode(message.data)
        except (McapError, DecodeError, struct.error, ValueError) as error:
            raise DamagedFileError(f"{self.path.name} is damaged: {error}") from None


def _reader(path: Path) -> SeekingReader:
    stat = path.stat()
    thread = (os.getpid(), threading.get_ident())
    return _open_reader(path, stat.st_ino, stat.st_mtime_ns, thread)


@lru_cache(maxsize=64)
def _open_reader(path: Path, *_identity: object) -> SeekingReader:
    """A reader whose index is kept; inode and time tell a rewritten file.

    A reader has one position in its file, so every process and thread has its own.
    """
    return SeekingReader(path.open("rb"), validate_crcs=True)


def recover(path: Path, key: str, topic: Topic[T]) -> Iterator[bytes]:
    """Encoded messages of a topic from the whole part of a file that was cut short.

    Nothing comes if the file is not there or was written for another key.
    """
    if not path.exists():
        return
    channels: set[int] = set()
    with path.open("rb") as stream, suppress(McapError, struct.error, ValueError):
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Metadata) and record.name == "stage":
                if record.metadata.get("key") != key:
                    return
            elif isinstance(record, Channel) and record.topic == topic.name:
                channels.add(record.id)
            elif isinstance(record, Message) and record.channel_id in channels:
                yield record.data
