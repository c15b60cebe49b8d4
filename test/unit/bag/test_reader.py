# SPDX-License-Identifier: Apache-2.0
"""Reading selects topics and times, and reports the defects of a broken bag."""

import struct
from pathlib import Path

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy

from tactile_hand_ros.bag.metadata import offered_qos
from tactile_hand_ros.bag.reader import read_messages, read_topics, summarize
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError

FLOAT = b"\0\1\0\0" + bytes(range(8))


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of ten messages on each of two topics, times 0, 1, ... 19 ns."""
    folder = tmp_path / "run"
    with BagWriter(folder) as writer:
        even = writer.add_channel("/even", "std_msgs/msg/Float64")
        odd = writer.add_channel("/odd", "std_msgs/msg/Float64")
        for i in range(20):
            writer.write(odd if i % 2 else even, FLOAT, i, i)
    return folder


def test_topics_can_be_chosen_and_are_summarized(bag):
    assert [m.log_time for m in read_messages(bag, ["/odd"])] == list(range(1, 20, 2))
    assert list(read_messages(bag, [])) == []
    assert list(read_messages(bag, ["/absent"])) == []
    assert len(list(read_messages(bag))) == 20
    assert next(read_messages(bag, {"/even"})).message.data == struct.unpack("<d", FLOAT[4:])[0]
    summary = summarize(bag)
    assert summary.counts == {"/even": 10, "/odd": 10}
    assert summary.types["/odd"] == "std_msgs/msg/Float64"
    assert (summary.start_time, summary.message_count) == (0, 20)


def test_custom_data_are_read_from_a_folder_and_from_its_file(tmp_path):
    """A folder may be named like a file; the last record in a file counts."""
    folder = tmp_path / "run.mcap"
    with BagWriter(folder) as writer:
        writer.custom_data |= {"lost_messages": "3", "scenario": "name: x\nseed: 1\n"}
    assert summarize(folder).custom_data == writer.custom_data
    assert summarize(writer.path).custom_data == writer.custom_data
    BagWriter(tmp_path / "other.mcap").close()
    assert summarize(tmp_path / "other.mcap").custom_data == {}


def test_messages_of_all_connections_of_a_topic_are_counted_and_read(tmp_path):
    """Two publishers with different QoS offers are two connections in a file."""
    with BagWriter(tmp_path / "run") as writer:
        kinds = (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT)
        offers = [[offered_qos(QoSProfile(depth=1, reliability=kind))] for kind in kinds]
        both = [writer.add_channel("/x", "std_msgs/msg/Float64", offers=each) for each in offers]
        for time, channel in enumerate(2 * both + both[:1]):
            writer.write(channel, FLOAT, time, time)
        writer.write(writer.add_channel("/y", "std_msgs/msg/Float64"), FLOAT, 9, 9)
    file = tmp_path / "run" / "run_0.mcap"
    assert summarize(file).counts == {"/x": 5, "/y": 1}
    assert [m.log_time for m in read_messages(file, ["/x"])] == [0, 1, 2, 3, 4]


def test_what_is_no_bag_is_refused_with_a_reason(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    for path, text in (
        (tmp_path / "nowhere", "nowhere does not exist"),
        (tmp_path, "is not a bag, or its recording was cut off"),
        (tmp_path / "notes.txt", "notes.txt is not a bag; give the folder of a run"),
    ):
        with pytest.raises(BagError, match=text):
            summarize(path)


@pytest.mark.parametrize("size", [0, 8, 600, -1, -40])
def test_truncated_file(bag, size):
    path = bag / "run_0.mcap"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(BagError, match=f"tactile-hand recover {bag}"):
        list(read_messages(bag))


def test_damaged_chunk_is_found_while_reading(bag):
    """The index is intact, but the checksum reveals a damaged message."""
    path = bag / "run_0.mcap"
    data = bytearray(path.read_bytes())
    at = data.rindex(FLOAT)
    data[at + 5] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(BagError, match="checksum"):
        list(read_messages(bag))
    with pytest.raises(BagError, match="checksum"):
        read_topics(bag, ["/even"])


def test_message_that_is_no_message(tmp_path):
    wrong = [b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(3)]
    with BagWriter(tmp_path / "run") as writer:
        channel = writer.add_channel("/x", "std_msgs/msg/Float64")
        for time, data in enumerate(wrong):
            writer.write(channel, data, time, time)
    for found, data in zip(read_messages(tmp_path / "run"), wrong, strict=True):
        assert found.data == data
        with pytest.raises(BagError, match="not a valid std_msgs/msg/Float64"):
            _ = found.message


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("message_count: 20", "message_count: x"),
        ("name: /even", "name: [a]"),
        ("- run_0.mcap", "- ../other.mcap"),
        ("custom_data: {}", "custom_data: [a]"),
        ("rosbag2_bagfile_information:", "other:"),
        ("rosbag2_bagfile_information:", f"rosbag2_bagfile_information: {50_000 * '['}"),
    ],
)
def test_damaged_metadata_are_refused(bag, old, new):
    file = bag / "metadata.yaml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(BagError, match="damaged"):
        summarize(bag)
