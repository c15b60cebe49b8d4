# SPDX-License-Identifier: Apache-2.0
"""Bags written here are whole to every reader, also after a failure."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import String

from tactile_hand_ros.bag.qos import OfferedQos, qos_text
from tactile_hand_ros.bag.reader import read_messages, read_raw, summarize
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError

STRING = "std_msgs/msg/String"
STRING_HASH = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(STRING)


def payload(text: str) -> bytes:
    """Return the CDR of a String."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def add_string(writer: BagWriter, topic: str = "/chatter") -> int:
    """Add a channel of type String."""
    return writer.add_channel(topic, STRING, offers=[OfferedQos()], type_hash=STRING_HASH)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_rosbags_reads_back_what_was_written(tmp_path: Path, compression: str) -> None:
    """Counts, times, types, QoS and bytes."""
    sent = [payload(f"message {i}") for i in range(3000)]
    with BagWriter(tmp_path / "run", compression=compression, chunk_size=4096) as writer:
        channel, other = add_string(writer), add_string(writer, "/left/other")
        for i, data in enumerate(sent):
            writer.write(channel, data, 10_000 + i, 9_000 + i)
        writer.write(other, payload("x"), 10_500, 10_400)
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 3001
        assert (reader.start_time, reader.end_time) == (10_000, 13_000)
        connection = reader.topics["/chatter"].connections[0]
        assert (connection.msgtype, connection.digest) == (STRING, STRING_HASH)
        assert connection.ext.offered_qos_profiles[0].reliability.name == "RELIABLE"
        got = [(time, bytes(data)) for _, time, data in reader.messages([connection])]
    assert got == [(10_000 + i, data) for i, data in enumerate(sent)]


def test_mcap_holds_what_rosbag2_puts_there(tmp_path: Path) -> None:
    """Profile, schema, channel texts, sequence zero, both times, metadata at open and at close."""
    with BagWriter(tmp_path / "run", compression="zstd") as writer:
        writer.write(add_string(writer), payload("x"), 2_000, 1_000)
    with writer.path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        [(schema, channel, message)] = list(reader.iter_messages())
        metadata = list(reader.iter_metadata())
    assert schema is not None
    assert (schema.name, schema.encoding) == (STRING, "ros2msg")
    assert schema.data.decode() == message_definition(STRING).text
    assert channel.message_encoding == "cdr"
    assert channel.metadata == {
        "offered_qos_profiles": qos_text([OfferedQos()]),
        "topic_type_hash": STRING_HASH,
    }
    assert (message.sequence, message.log_time, message.publish_time) == (0, 2_000, 1_000)
    assert [record.name for record in metadata] == ["rosbag2", "rosbag2"]
    assert [message_count(record) for record in metadata] == [0, 1]
    whole = yaml.safe_load((writer.folder / "metadata.yaml").read_text())
    last = yaml.safe_load(metadata[1].metadata["serialized_metadata"])
    assert whole == {"rosbag2_bagfile_information": last}


def message_count(record: Metadata) -> Any:
    """Return the message count in a metadata record."""
    return yaml.safe_load(record.metadata["serialized_metadata"])["message_count"]


def test_bag_without_messages_is_valid(tmp_path: Path) -> None:
    """A channel that never spoke, or no channel at all."""
    with BagWriter(tmp_path / "silent") as writer:
        add_string(writer)
    BagWriter(tmp_path / "empty").close()
    silent = summarize(tmp_path / "silent")
    assert (silent.counts, silent.start_time) == ({"/chatter": 0}, None)
    assert summarize(tmp_path / "empty").counts == {}


def test_close_is_idempotent(tmp_path: Path) -> None:
    """The second call writes nothing and says the same."""
    writer = BagWriter(tmp_path / "run")
    writer.write(add_string(writer), payload("x"), 1, 1)
    first = writer.close()
    size = writer.path.stat().st_size
    assert writer.close() == first
    assert writer.path.stat().st_size == size


def test_custom_data_reaches_the_reader(tmp_path: Path) -> None:
    """Texts that look like numbers stay texts."""
    with BagWriter(tmp_path / "run") as writer:
        writer.custom_data["lost_messages"] = "0"
    assert summarize(tmp_path / "run").custom_data == {"lost_messages": "0"}


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_existing_output_is_refused(tmp_path: Path, kind: str) -> None:
    """Nothing is overwritten."""
    target = tmp_path / "run"
    target.mkdir() if kind == "folder" else target.write_text("precious")
    with pytest.raises(BagError, match=f"{target} exists already"):
        BagWriter(target)
    assert kind == "folder" or target.read_text() == "precious"


def test_output_that_cannot_be_created_is_refused(tmp_path: Path) -> None:
    """The reason of the operating system is in the sentence."""
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="Not a directory"):
        BagWriter(tmp_path / "file" / "run")


def test_unknown_compression_is_refused_before_anything_is_created(tmp_path: Path) -> None:
    """The sentence lists the valid names."""
    with pytest.raises(BagError, match="'gzip'.*none, lz4, zstd"):
        BagWriter(tmp_path / "run", compression="gzip")
    assert not (tmp_path / "run").exists()


def test_closed_bag_takes_nothing(tmp_path: Path) -> None:
    """Neither messages nor channels."""
    writer = BagWriter(tmp_path / "run")
    channel = add_string(writer)
    writer.close()
    with pytest.raises(BagError, match="is closed"):
        writer.write(channel, payload("x"), 1, 1)
    with pytest.raises(BagError, match="is closed"):
        add_string(writer, "/other")


@pytest.fixture
def small_disk() -> Iterator[int]:
    """Let files of this process grow to 100 kB only, as a full disk would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    yield 100_000
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    signal.signal(signal.SIGXFSZ, handler)


def test_full_disk_is_a_clear_error_and_keeps_whole_chunks(tmp_path: Path, small_disk: int) -> None:
    """The file ends with its last whole chunk, from which all its messages can be read."""
    writer = BagWriter(tmp_path / "run", chunk_size=10_000)
    channel = add_string(writer)
    with pytest.raises(BagError, match="could not be written.*tactile-hand recover") as caught:
        for i in range(10_000):
            writer.write(channel, payload("x" * 100), i, i)
    assert not writer.is_open
    assert writer.path.stat().st_size <= small_disk
    assert writer.close().message_count > 0  # closing after the failure is harmless
    assert recovered(writer.path) == writer.message_count
    assert f"ended after {writer.message_count} messages" in str(caught.value)


def recovered(path: Path) -> int:
    """Return how many messages can be read from a file without an index."""
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        return sum(_is_message(record) for record in _until_the_end(records))


def _until_the_end(records: Iterator[Any]) -> Iterator[Any]:
    try:
        yield from records
    except Exception as error:
        assert type(error).__name__ == "EndOfFile"  # no footer, but only whole records


def _is_message(record: Any) -> bool:
    return type(record).__name__ == "Message"


def test_flushed_messages_survive_a_killed_process(tmp_path: Path) -> None:
    """What was flushed before SIGKILL is on disk, byte for byte."""
    code = (
        "import os, signal, sys; from tactile_hand_ros.bag.writer import BagWriter\n"
        "w = BagWriter(sys.argv[1], compression='lz4')\n"
        f"c = w.add_channel('/c', '{STRING}')\n"
        f"for i in range(123): w.write(c, {payload('x')!r}, i, i)\n"
        "w.flush()\n"
        f"w.write(c, {payload('x')!r}, 123, 123)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    run = subprocess.run([sys.executable, "-c", code, tmp_path / "run"], env=os.environ)
    assert run.returncode == -signal.SIGKILL
    assert recovered(tmp_path / "run" / "run_0.mcap") == 123
    with pytest.raises(BagError, match="cut off.*tactile-hand recover"):
        summarize(tmp_path / "run")


_TIMES = st.integers(0, 2**62)


@settings(max_examples=25)
@given(
    messages=st.lists(st.tuples(st.booleans(), st.binary(max_size=300), _TIMES, _TIMES)),
    compression=st.sampled_from(["none", "lz4", "zstd"]),
)
def test_any_bytes_and_times_come_back(
    tmp_path_factory: pytest.TempPathFactory,
    messages: list[tuple[bool, bytes, int, int]],
    compression: str,
) -> None:
    """Payloads are opaque: whatever goes in comes out, in order of log time."""
    folder = tmp_path_factory.mktemp("bags") / "run"
    with BagWriter(folder, compression=compression, chunk_size=256) as writer:
        channels = [add_string(writer, "/a"), add_string(writer, "/b")]
        for second, data, log_time, publish_time in messages:
            writer.write(channels[second], data, log_time, publish_time)
    got = [tuple(message) for message in read_raw(folder)]
    expected = [("/b" if second else "/a", time, data) for second, data, time, _ in messages]
    assert sorted(got) == sorted(expected)
    assert [time for _, time, _ in got] == sorted(time for _, time, _ in got)


@settings(max_examples=25)
@given(text=st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])))
def test_messages_of_ros_decode_to_the_same_content(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    """ROS serializes, rosbags decodes, ROS decodes the recorded bytes."""
    folder = tmp_path_factory.mktemp("bags") / "run"
    with BagWriter(folder) as writer:
        writer.write(add_string(writer), serialize_message(String(data=text)), 1, 1)
    [decoded] = read_messages(folder)
    [raw] = read_raw(folder)
    assert decoded.message.data == text
    assert deserialize_message(raw.data, String).data == text


def test_metadata_record_is_read_by_name_beside_those_of_rosbag2(tmp_path: Path) -> None:
    """Also in a bag that was cut off: it stands at the front."""
    said = {"scenario": "name: paper\nseed: 1\n", "version": "1"}
    writer = BagWriter(tmp_path / "run", custom_data=dict(said))
    writer.add_metadata("origin", said)
    writer.flush()
    with writer.path.open("rb") as stream:
        records = _until_the_end(StreamReader(stream).records)
        cut_off = [record for record in records if isinstance(record, Metadata)]
    assert [record.name for record in cut_off] == ["rosbag2", "origin"]
    assert cut_off[1].metadata == said
    first = yaml.safe_load(cut_off[0].metadata["serialized_metadata"])
    assert first["custom_data"] == said
    writer.close()
    assert summarize(tmp_path / "run").custom_data == said


@pytest.mark.parametrize("limit", ["max_size", "max_duration"])
def test_bag_is_split_and_reads_as_one(tmp_path: Path, limit: str) -> None:
    """metadata.yaml lists all files as rosbag2 does; each has all channels and opens alone."""
    with BagWriter(tmp_path / "run", chunk_size=1000, **{limit: 5000}) as writer:
        writer.add_metadata("origin", {"a": "b"})
        first, second = add_string(writer), add_string(writer, "/late")
        for i in range(300):
            writer.write(first if i % 2 else second, payload("x" * 40), 100 * i, 0)
    told = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())
    told = told["rosbag2_bagfile_information"]
    paths = told["relative_file_paths"]
    assert paths == [f"run_{i}.mcap" for i in range(len(paths))] and len(paths) > 3
    assert [file["path"] for file in told["files"]] == paths
    assert sum(file["message_count"] for file in told["files"]) == told["message_count"] == 300
    starts = [file["starting_time"]["nanoseconds_since_epoch"] for file in told["files"]]
    assert starts == sorted(starts)
    if limit == "max_duration":
        assert all(5000 <= file["duration"]["nanoseconds"] < 5200 for file in told["files"][:-1])
    with Reader(tmp_path / "run") as reader:
        assert [time for _, time, _ in reader.messages()] == [100 * i for i in range(300)]
    with (tmp_path / "run" / paths[1]).open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None and len(summary.channels) == 2
        records = [record.name for record in make_reader(stream).iter_metadata()]
    assert records == ["rosbag2", "origin", "rosbag2"]


def test_file_ends_with_the_message_that_reaches_the_size(tmp_path: Path) -> None:
    """At just that size, not one byte later."""

    def fill(name: str, limit: int) -> BagWriter:
        writer = BagWriter(tmp_path / name, chunk_size=1, max_size=limit)
        channel = add_string(writer)
        for i in range(9):
            sizes.append(writer.path.stat().st_size)
            writer.write(channel, payload("x"), i, i)
            assert writer.message_count == i + 1
        return writer

    sizes: list[int] = []
    fill("none", 0).close()
    reached = sizes[5]  # with five messages; equally long names give equal sizes
    for name, limit, expected in (("same", reached, 5), ("more", reached + 1, 6)):
        writer = fill(name, limit)
        assert [file.message_count for file in writer.close().files][:1] == [expected]
        assert writer.message_count == summarize(writer.folder).message_count == 9


def test_file_ends_with_the_message_that_reaches_the_duration(tmp_path: Path) -> None:
    """Recorded time counts, from the earliest message to the latest, in whatever order."""
    with BagWriter(tmp_path / "run", max_duration=300) as writer:
        channel = add_string(writer)
        counts = []
        for time in (1000, 1100, 1299, 1300, 1400, 1350, 1101, 1100, 5000):
            writer.write(channel, payload("x"), time, 0)
            counts.append(writer.message_count)
    assert counts == list(range(1, 10))
    assert [file.message_count for file in writer.metadata().files] == [4, 4, 1]


def test_messages_of_all_files_are_counted_also_when_the_disk_is_full(
    tmp_path: Path, small_disk: int
) -> None:
    """The sentence tells how many there are, in files that were finished, too."""
    writer = BagWriter(tmp_path / "run", chunk_size=1)
    channel = add_string(writer)
    for i in range(6):
        writer.write(channel, payload("x"), i, i)
        if i % 2:
            writer.split()
    writer.write(channel, payload("x"), 6, 6)
    with pytest.raises(BagError, match="recording ended after 7 messages"):
        writer.write(channel, payload("x" * small_disk), 7, 7)
    assert writer.message_count == 7
    assert [file.message_count for file in writer.metadata().files] == [2, 2, 2, 1]


def test_checkpoint_is_a_whole_bag_that_goes_on(tmp_path: Path) -> None:
    """metadata.yaml is there only while all files are whole."""
    writer = BagWriter(tmp_path / "run", lazy=True)
    channel = add_string(writer)
    assert list(writer.folder.iterdir()) == []
    for part in range(2):
        writer.write(channel, payload("x"), part, part)
        assert not (writer.folder / "metadata.yaml").exists()
        writer.checkpoint()
        assert summarize(writer.folder).message_count == part + 1
    assert len(writer.close().files) == 2


def test_a_lazy_bag_without_messages_is_valid_and_nothing_is_begun_twice(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "run", lazy=True)
    add_string(writer)
    writer.add_metadata("origin", {"a": "b"})
    writer.flush()
    writer.split()
    assert list(writer.folder.iterdir()) == [] and writer.is_open
    first = writer.close()
    assert [file.path for file in first.files] == ["run_0.mcap"] and not writer.is_open
    assert first.files[0].duration == 0
    assert (first.duration, first.message_count, first.topics[0].name) == (0, 0, "/chatter")
    assert summarize(tmp_path / "run").counts == {"/chatter": 0}
    earlier = BagWriter(tmp_path / "run", earlier=first, lazy=True).close()
    assert [file.path for file in earlier.files] == ["run_0.mcap"]


def test_what_a_bag_says_before_it_is_closed(tmp_path: Path) -> None:
    """Counts by topic, bytes, times; a message at time zero takes no time."""
    writer = BagWriter(tmp_path / "run")
    first, second = add_string(writer, "/b"), add_string(writer, "/a")
    assert (first, second) == (1, 2)
    writer.write(first, payload("x"), 0, 0)
    assert (writer.metadata().start, writer.metadata().duration) == (0, 0)
    for time in (7, 5):
        writer.write(second, payload("xy"), time, 0)
    assert writer.counts() == {"/b": 1, "/a": 2}
    assert writer.bytes_received == len(payload("x") + 2 * payload("xy"))
    metadata = writer.metadata()
    assert (metadata.start, metadata.duration, metadata.message_count) == (0, 7, 3)
    assert [topic.name for topic in metadata.topics] == ["/a", "/b"]
    assert writer.close() == metadata
    with pytest.raises(BagError, match="is closed"):
        writer.add_metadata("origin", {})
    writer.flush()


def test_a_topic_of_a_bag_that_is_continued_keeps_its_offers(tmp_path: Path) -> None:
    """Readers take a topic with other offers in a later file for another topic."""
    old, new = OfferedQos(depth=7), OfferedQos(depth=9)
    with BagWriter(tmp_path / "run") as writer:
        writer.add_channel("/a", STRING, offers=[old], type_hash="RIHS01_old")
        writer.add_channel("/b", STRING, offers=[old], type_hash="RIHS01_old")
    with BagWriter(tmp_path / "run", earlier=writer.metadata()) as later:
        for name, kind in (("/a", STRING), ("/b", "std_msgs/msg/Empty"), ("/c", STRING)):
            later.add_channel(name, kind, offers=[new], type_hash="RIHS01_new")
    with later.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert later.path.name == "run_1.mcap" and summary is not None
    told = {each.topic: each.metadata for each in summary.channels.values()}
    assert [told[name]["topic_type_hash"] for name in ("/a", "/b", "/c")] == [
        "RIHS01_old",
        "RIHS01_new",
        "RIHS01_new",
    ]
    assert told["/a"]["offered_qos_profiles"] == qos_text([old])
    assert told["/b"]["offered_qos_profiles"] == qos_text([new])


def test_channels_of_one_type_share_its_schema(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as writer:
        for name, kind in (("/a", STRING), ("/b", "std_msgs/msg/Empty"), ("/c", STRING)):
            writer.add_channel(name, kind)
    with writer.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {each.name for each in summary.schemas.values()} == {STRING, "std_msgs/msg/Empty"}
    assert [each.schema_id for each in summary.channels.values()] == [1, 2, 1]


def test_folders_above_the_bag_are_created(tmp_path: Path) -> None:
    BagWriter(tmp_path / "a" / "b" / "run").close()
    assert summarize(tmp_path / "a" / "b" / "run").message_count == 0


def test_a_chunk_of_the_default_size_is_written_as_soon_as_it_is_full(tmp_path: Path) -> None:
    """What a recorder loses that is killed; messages and their heads count."""
    writer = BagWriter(tmp_path / "run")
    channel, before, count = add_string(writer), 0, 0
    while writer.path.stat().st_size <= max(before, 5000):
        before = writer.path.stat().st_size
        writer.write(channel, bytes(1000), 0, 0)
        count += 1
    assert 2**20 - 2000 < count * (1000 + 31) < 2**20 + 2000
    writer.close()


def test_a_disk_that_is_full_at_once_leaves_an_empty_file(tmp_path: Path) -> None:
    """Not even the first bytes of a file fit."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4, limits[1]))
    try:
        with pytest.raises(BagError, match="could not be written"):
            BagWriter(tmp_path / "run")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert (tmp_path / "run" / "run_0.mcap").stat().st_size == 0
