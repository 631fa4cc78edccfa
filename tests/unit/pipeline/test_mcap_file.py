"""Stage files: messages found by index, every damage noticed, whole parts recovered."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from spinpipe.pipeline.mcap_file import (
    EPOCH_NS,
    DamagedFileError,
    Messages,
    StageFileWriter,
    check,
    read_metadata,
    recover,
)
from spinpipe.schemas import CLUSTERS, HITS
from spinpipe.schemas.records import Cluster, Hits


def hits(number: int, points: int = 5) -> Hits:
    xyz = np.full((points, 3), number, np.float32)
    return Hits(f"model {number}", xyz, xyz[:, 0])


def cluster(number: int) -> Cluster:
    return Cluster(number, "car", (1.0, 2.0, float(number)), 3, 0.9, "delaunay")


def write(path: Path, messages: int = 6, clusters: int = 2) -> Path:
    writer = StageFileWriter(path, {"stage": "scan", "key": "k1"})
    writer.declare(HITS)
    for number in range(messages):
        writer.write(HITS, hits(number))
    for number in range(clusters):
        writer.write(CLUSTERS, cluster(number))
    writer.close({"seconds": "1.5"})
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("mcap") / "03_scan.mcap")


def test_messages_are_a_sequence(file: Path) -> None:
    messages = Messages(file, HITS)
    assert len(messages) == 6
    assert [m.model for m in messages] == [f"model {i}" for i in range(6)]
    assert messages[2].model == "model 2"
    assert messages[-1].model == "model 5"
    assert [m.model for m in messages[1:6:2]] == ["model 1", "model 3", "model 5"]
    with pytest.raises(IndexError):
        messages[6]
    assert [c.id for c in Messages(file, CLUSTERS)] == [0, 1]


def test_messages_can_be_pickled(file: Path) -> None:
    messages = pickle.loads(pickle.dumps(Messages(file, HITS)))
    assert messages[3].model == "model 3"


def test_a_topic_without_messages_is_empty_but_declared(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", messages=0, clusters=1)
    assert len(Messages(path, HITS)) == 0
    assert list(Messages(path, HITS)) == []
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert HITS.name in {channel.topic for channel in summary.channels.values()}


def test_metadata_can_be_read_back(file: Path) -> None:
    assert read_metadata(file, "stage") == {"stage": "scan", "key": "k1"}
    assert read_metadata(file, "result") == {"seconds": "1.5"}
    assert read_metadata(file, "nothing") == {}


def test_a_record_stands_a_second_after_the_one_before(tmp_path: Path) -> None:
    writer = StageFileWriter(tmp_path / "a.mcap", {}, number=3)
    for number in range(3):
        writer.write(HITS, hits(number))
    writer.write(CLUSTERS, cluster(7))
    writer.close({})
    with (tmp_path / "a.mcap").open("rb") as stream:
        found = [(c.topic, m.log_time) for _, c, m in make_reader(stream).iter_messages()]
    seconds = {(topic, (time - EPOCH_NS) / 1e9) for topic, time in found}
    assert seconds == {(HITS.name, 30), (HITS.name, 31), (HITS.name, 32), (CLUSTERS.name, 30)}


def test_a_file_of_an_older_format_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "old.mcap").open("wb") as stream:  # as it was written before
        old = Writer(stream, enable_data_crcs=True)
        old.start(profile="", library="spinpipe")
        old.add_metadata("topics", {HITS.name: "[0, 3]"})
        old.finish()
    with pytest.raises(DamagedFileError, match=r"old\.mcap was not written by this version"):
        Messages(tmp_path / "old.mcap", HITS)


def test_equal_messages_make_equal_bytes(file: Path, tmp_path: Path) -> None:
    assert write(tmp_path / "again.mcap").read_bytes() == file.read_bytes()


def test_messages_of_a_topic_must_stand_together(tmp_path: Path) -> None:
    writer = StageFileWriter(tmp_path / "a.mcap", {})
    writer.write(HITS, hits(0))
    writer.write(CLUSTERS, cluster(0))
    with pytest.raises(ValueError, match="together"):
        writer.write(HITS, hits(1))
    writer.abandon()


def test_messages_larger_than_a_chunk_come_back(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    writer = StageFileWriter(path, {})
    large = [hits(number, points=200_000) for number in range(3)]
    for message in large:
        writer.write(HITS, message)
    writer.close({})
    for expected, got in zip(large, Messages(path, HITS), strict=True):
        np.testing.assert_array_equal(got.points, expected.points)


@given(data=st.data())
@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_flipped_bit_is_noticed(file: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(file.read_bytes())
    offset = data.draw(st.integers(0, len(content) - 1), label="offset")
    content[offset] ^= 1 << data.draw(st.integers(0, 7), label="bit")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"^damaged\.mcap "):
        check(damaged)


@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_cut_is_noticed(file: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = file.read_bytes()
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content[: data.draw(st.integers(0, len(content) - 1), label="length")])
    with pytest.raises(DamagedFileError):
        check(damaged)


@given(data=st.data())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whole_messages_of_a_cut_file_are_recovered(
    file: Path, tmp_path: Path, data: st.DataObject
) -> None:
    content = file.read_bytes()
    length = data.draw(st.integers(0, len(content)), label="length")
    cut = tmp_path / "cut.partial"
    cut.write_bytes(content[:length])
    numbers = [HITS.decode(message).model for message in recover(cut, "k1", HITS)]
    assert numbers == [f"model {i}" for i in range(len(numbers))]
    assert list(recover(cut, "another key", HITS)) == []


def test_everything_written_before_a_kill_is_recovered(tmp_path: Path) -> None:
    path = tmp_path / "killed.partial"
    writer = StageFileWriter(path, {"key": "k1"})
    for number in range(4):
        writer.write(HITS, hits(number, points=100_000))
    killed = tmp_path / "copy.partial"
    shutil.copy(path, killed)  # as a kill would leave it: nothing closed, nothing flushed
    writer.abandon()
    assert len(list(recover(killed, "k1", HITS))) >= 3


def test_nothing_is_recovered_from_nothing(tmp_path: Path) -> None:
    assert list(recover(tmp_path / "missing", "k1", HITS)) == []
    (tmp_path / "other").write_bytes(b"not an mcap file")
    assert list(recover(tmp_path / "other", "k1", HITS)) == []


def test_reading_a_damaged_message_is_refused(file: Path, tmp_path: Path) -> None:
    content = bytearray(file.read_bytes())
    content[content.index(b"model 3")] ^= 255
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    with pytest.raises(DamagedFileError):
        list(Messages(damaged, HITS))


def test_a_file_that_was_replaced_is_read_anew(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", messages=2)
    assert len(list(Messages(path, HITS))) == 2
    write(tmp_path / "b.mcap", messages=5).replace(path)
    assert len(list(Messages(path, HITS))) == 5
