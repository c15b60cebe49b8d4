# SPDX-License-Identifier: Apache-2.0
"""Bags are readable by every reader, even after a failure."""

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from rclpy.qos import QoSProfile
from rosbags.rosbag2 import Reader
from support.messages import STRING, STRING_HASH, payload

from tactile_hand_ros.bag.metadata import dump, offered_qos
from tactile_hand_ros.bag.reader import read_messages, read_topics, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError

OFFER = offered_qos(QoSProfile(depth=1))


def add_string(writer: BagWriter, topic: str = "/chatter") -> int:
    return writer.add_channel(topic, STRING, offers=[OFFER], type_hash=STRING_HASH)


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_other_libraries_read_back_what_was_written(tmp_path, compression):
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
    texts = [each.ros_msg.data for each in read_ros2_messages(writer.path, topics=["/chatter"])]
    assert texts == [f"message {i}" for i in range(3000)]


def test_mcap_holds_what_rosbag2_puts_there(tmp_path):
    with BagWriter(tmp_path / "run", compression="zstd") as writer:
        writer.write(add_string(writer), payload("x"), 2_000, 1_000)
        for name, kind in (("/b", "std_msgs/msg/Empty"), ("/c", STRING)):
            writer.add_channel(name, kind)
    with writer.path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        [(schema, channel, message)] = list(reader.iter_messages())
        metadata = list(reader.iter_metadata())
    assert summary is not None and schema is not None
    assert {each.name for each in summary.schemas.values()} == {STRING, "std_msgs/msg/Empty"}
    assert [each.schema_id for each in summary.channels.values()] == [1, 2, 1]
    assert (schema.name, schema.encoding) == (STRING, "ros2msg")
    assert schema.data.decode() == message_definition(STRING).text
    assert channel.message_encoding == "cdr"
    assert channel.metadata == {
        "offered_qos_profiles": dump([OFFER]),
        "topic_type_hash": STRING_HASH,
    }
    assert (message.sequence, message.log_time, message.publish_time) == (0, 2_000, 1_000)
    assert [record.name for record in metadata] == ["rosbag2", "rosbag2"]
    first, last = [yaml.safe_load(each.metadata["serialized_metadata"]) for each in metadata]
    assert (first["message_count"], last["message_count"]) == (0, 1)
    whole = yaml.safe_load((writer.folder / "metadata.yaml").read_text())
    assert whole == {"rosbag2_bagfile_information": last}


def test_bag_without_messages_is_valid(tmp_path):
    with BagWriter(tmp_path / "silent") as writer:
        add_string(writer)
    BagWriter(tmp_path / "new" / "empty").close()
    silent = summarize(tmp_path / "silent")
    empty = yaml.safe_load((tmp_path / "new" / "empty" / "metadata.yaml").read_text())
    [file] = empty["rosbag2_bagfile_information"]["files"]
    assert file["starting_time"]["nanoseconds_since_epoch"] == 2**63 - 1
    assert (file["duration"]["nanoseconds"], file["message_count"]) == (0, 0)
    assert (silent.counts, silent.start_time) == ({"/chatter": 0}, None)
    assert summarize(tmp_path / "new" / "empty").counts == {}


def test_a_name_that_is_too_long_for_its_file_is_refused(tmp_path):
    with pytest.raises(BagError, match="cannot be created: File name too long"):
        BagWriter(tmp_path / ("x" * 252))


def test_full_disk_is_a_clear_error_and_what_was_written_can_be_recovered(tmp_path, small_disk):
    writer = BagWriter(tmp_path / "run", chunk_size=10_000)
    channel = add_string(writer)
    with pytest.raises(BagError, match="could not be written.*tactile-hand recover"):
        for i in range(10_000):
            writer.write(channel, payload("x" * 100), i, i)
    assert not writer.is_open and not (tmp_path / "run" / "metadata.yaml").exists()
    assert writer.path.stat().st_size <= small_disk
    writer.close()  # after the failure it is harmless
    messages = recover(tmp_path / "run", tmp_path / "out").metadata.message_count
    written = writer.metadata().message_count
    assert written - 200 < messages <= written


_TIMES = st.integers(0, 2**62)


@settings(max_examples=25)
@given(
    messages=st.lists(st.tuples(st.booleans(), st.binary(max_size=300), _TIMES, _TIMES)),
    compression=st.sampled_from(["none", "lz4", "zstd"]),
)
def test_any_bytes_and_times_come_back(tmp_path_factory, messages, compression):
    folder = tmp_path_factory.mktemp("bags") / "run"
    with BagWriter(folder, compression=compression, chunk_size=256) as writer:
        channels = [add_string(writer, "/a"), add_string(writer, "/b")]
        for second, data, log_time, publish_time in messages:
            writer.write(channels[second], data, log_time, publish_time)
    got = [message[:3] for message in read_messages(folder)]
    expected = [("/b" if second else "/a", time, data) for second, data, time, _ in messages]
    for topic, found in read_topics(folder, ["/a", "/b"]).items():
        of_topic = [each for each in got if each[0] == topic]
        assert [(topic, *pair) for pair in zip(*found, strict=True)] == of_topic
    assert sorted(got) == sorted(expected)
    assert [time for _, time, _ in got] == sorted(time for _, time, _ in got)


def test_what_a_bag_says_before_it_is_closed(tmp_path):
    writer = BagWriter(tmp_path / "run")
    first, second = add_string(writer, "/b"), add_string(writer, "/a")
    assert (first, second) == (1, 2)
    writer.write(first, payload("x"), 0, 0)
    assert (writer.metadata().start, writer.metadata().duration) == (0, 0)
    for time in (7, 5):
        writer.write(second, payload("xy"), time, 0)
    metadata = writer.metadata()
    assert (metadata.start, metadata.duration, metadata.message_count) == (0, 7, 3)
    assert [topic.name for topic in metadata.topics] == ["/a", "/b"]
    assert writer.close() == metadata == writer.close()
    for call in (
        lambda: writer.write(first, payload("x"), 1, 1),
        lambda: add_string(writer, "/other"),
        lambda: writer.add_metadata("origin", {}),
        writer.flush,
    ):
        with pytest.raises(BagError, match="is closed"):
            call()


def test_a_chunk_of_the_default_size_is_written_as_soon_as_it_is_full(tmp_path):
    """A killed recorder loses no more than this; messages and their headers count."""
    writer = BagWriter(tmp_path / "run")
    channel, before, count = add_string(writer), 0, 0
    while writer.path.stat().st_size <= max(before, 5000):
        before = writer.path.stat().st_size
        writer.write(channel, bytes(1000), 0, 0)
        count += 1
    assert 2**20 - 2000 < count * (1000 + 31) < 2**20 + 2000
    writer.close()
