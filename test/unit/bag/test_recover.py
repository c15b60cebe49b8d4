# SPDX-License-Identifier: Apache-2.0
"""Recovery of cut or damaged bags: all intact data returns, nothing is made up or destroyed."""

import contextlib
import io
import os
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from support.messages import STRING, STRING_HASH, payload

from tactile_hand_ros.bag.metadata import BagMetadata, dump, offered_qos
from tactile_hand_ros.bag.reader import find_bag, read_messages, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError

LATCHED = offered_qos(QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL))
COUNT = 400


def numbered(number: int) -> bytes:
    """Return the bytes of a String that compresses poorly."""
    return payload(f"{number} {hash((number, 'x')) ** 5}")


def write_bag(folder: Path, compression: str = "zstd", count: int = COUNT) -> None:
    """Write a bag of some chunks."""
    custom = {"scenario": "name: x\n"}
    with BagWriter(folder, compression, chunk_size=2000, custom_data=custom) as writer:
        channels = [
            writer.add_channel(name, STRING, offers=[LATCHED], type_hash=STRING_HASH)
            for name in ("/a", "/b")
        ]
        for i in range(count):
            writer.write(channels[i % 2], numbered(i), 1000 + i, 900 + i)


SENT = [numbered(i) for i in range(COUNT)]


@pytest.fixture(scope="module", params=["none", "lz4", "zstd"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag to copy and cut."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    write_bag(folder, request.param)
    return folder


@settings(max_examples=25)
@given(part=st.floats(0.0, 1.0))
def test_cut_at_any_byte_all_whole_chunks_come_back(whole, tmp_path_factory, part):
    folder = tmp_path_factory.mktemp("cut") / "run"
    shutil.copytree(whole, folder)
    file = folder / "run_0.mcap"
    before = file.read_bytes()[: round(part * file.stat().st_size)]
    file.write_bytes(before)
    (folder / "metadata.yaml").unlink()
    try:
        recovery = recover(folder)
    except BagError as error:  # cut in the first chunk
        assert "nothing" in str(error) and not any(chunks_of(before))
        assert os.listdir(folder.parent) == ["run"]
        return
    assert file.read_bytes() == before and os.listdir(folder) == ["run_0.mcap"]
    got = [m.data for m in read_messages(recovery.target)]
    assert got == SENT[: len(got)]
    assert len(got) == recovery.metadata.message_count >= sum(map(len, chunks_of(before)))
    summary = summarize(recovery.target)
    assert summary.message_count == len(got)
    assert summary.custom_data["recovered_bytes_left"] == str(recovery.left)
    assert summary.custom_data["scenario"] == "name: x\n"


def damage(file: Path, change: Callable[[bytearray], None]) -> None:
    data = bytearray(file.read_bytes())
    change(data)
    file.write_bytes(data)


@settings(max_examples=40)
@given(part=st.floats(0.0, 1.0), bit=st.integers(0, 7))
def test_one_damaged_byte_costs_at_most_one_chunk(whole, tmp_path_factory, part, bit):
    folder = tmp_path_factory.mktemp("damaged") / "run"
    shutil.copytree(whole, folder)
    file = folder / "run_0.mcap"
    at = 8 + round(part * (file.stat().st_size - 9))  # after the magic number

    def flip(data: bytearray) -> None:
        data[at] ^= 1 << bit

    sizes = [len(chunk) for chunk in chunks_of(file.read_bytes())]
    damage(file, flip)
    got = [m.data for m in read_messages(recover(folder).target)]
    assert set(got) <= set(SENT)
    assert COUNT - max(sizes) <= len(got) <= COUNT


def chunks_of(data: bytes) -> list[list[Message]]:
    """Return the messages of each complete chunk of a file that may be cut."""
    found: list[list[Message]] = []
    with contextlib.suppress(McapError, struct.error):
        for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
            if isinstance(record, Chunk):
                found.append([m for m in breakup_chunk(record) if isinstance(m, Message)])
    return found


def announce_too_much(data: bytearray) -> None:
    name = b"\4\0\0\0zstd"  # after the size and the checksum
    at = data.index(name, data.index(name) + 1)  # the first chunk has the channels
    data[at - 12 : at - 4] = (2**40).to_bytes(8, "little")


def end_in_zeros(data: bytearray) -> None:
    """A power failure leaves such zeros on the disk."""
    data[len(data) // 2 :] = bytes(5000)


def index_as_message(data: bytearray) -> None:
    chunk = make_reader(io.BytesIO(data)).get_summary().chunk_indexes[0]
    data[min(chunk.message_index_offsets.values())] = 5  # the opcode of a message


@pytest.mark.parametrize(
    ("change", "left", "lost"),
    [(announce_too_much, 500, 1), (end_in_zeros, 4000, 1), (index_as_message, 20, 0)],
)
def test_damage_that_looks_like_a_record_is_left_out(tmp_path, change, left, lost):
    write_bag(tmp_path / "run")
    damage(tmp_path / "run" / "run_0.mcap", change)
    recovery = recover(tmp_path / "run")
    assert 0 < recovery.metadata.message_count <= COUNT - lost and recovery.left > left


def test_topic_and_times_are_kept(tmp_path):
    write_bag(tmp_path / "run", count=3)
    target, metadata, left = recover(tmp_path / "run")
    topic = metadata.topics[0]
    assert (topic.name, topic.type, topic.type_hash) == ("/a", STRING, STRING_HASH)
    assert topic.offers == (LATCHED,) and topic.message_count == 2
    assert (metadata.start, metadata.duration) == (1000, 2)
    assert (target, metadata.message_count, left) == (tmp_path / "run_recovered", 3, 0)
    with (target / metadata.path).open("rb") as stream:
        times = [(m.log_time, m.publish_time) for _, _, m in make_reader(stream).iter_messages()]
    assert times == [(1000, 900), (1001, 901), (1002, 902)]


def foreign_file(file: Path, offers: str = "", schema: int = 1, time: int = 5) -> Path:
    """Write an MCAP file with metadata records, and a channel that may lack a schema."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another")
        for count in ("1", "2"):
            custom = {"count": count, f"at_{count}": count}
            writer.add_metadata("rosbag2", BagMetadata("x", custom_data=custom).record())
        writer.add_metadata("rosbag2", {"serialized_metadata": "[odd"})
        writer.add_metadata("rosbag2", {"serialized_metadata": "custom_data: 7"})
        writer.add_metadata("origin", {"a": "b"})
        writer.register_schema(STRING, "ros2msg", message_definition(STRING).text.encode())
        channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": offers})
        writer.add_message(channel, time, numbered(1), 4)
        writer.finish()
    return file


def test_several_files_become_one(tmp_path):
    (tmp_path / "foreign").mkdir()
    for number in (2, 10):
        foreign_file(tmp_path / "foreign" / f"foreign_{number}.mcap", time=number)
    recovery = recover(tmp_path / "foreign")
    assert [m.log_time for m in read_messages(recovery.target)] == [2, 10]
    assert summarize(recovery.target).counts == {"/a": 2}
    with AnyReader([recovery.target]) as reader:
        [connection] = reader.connections
        assert "string data" in connection.msgdef.data


def test_the_last_custom_data_count_and_other_records_are_kept(tmp_path):
    recovery = recover(foreign_file(tmp_path / "x.mcap"))
    assert recovery.target == tmp_path / "x_recovered"
    custom = {"count": "2", "at_1": "1", "at_2": "2", "recovered_bytes_left": "0"}
    assert summarize(recovery.target).custom_data == custom
    with (recovery.target / recovery.metadata.path).open("rb") as stream:
        records = {each.name: each.metadata for each in make_reader(stream).iter_metadata()}
    assert records["origin"] == {"a": "b"}


def test_offers_of_older_versions_have_names_afterwards(tmp_path):
    text = dump([{**LATCHED, "history": 1, "reliability": 2, "durability": 1, "liveliness": 1}])
    [topic] = recover(foreign_file(tmp_path / "x.mcap", text)).metadata.topics
    [offer] = topic.offers
    assert (offer["history"], offer["reliability"]) == ("keep_last", "best_effort")
    assert (offer["durability"], offer["liveliness"]) == ("transient_local", "automatic")
    for number, odd in enumerate(("7", "[7]", "- {history: x}", "[")):
        [topic] = recover(foreign_file(tmp_path / f"y{number}.mcap", odd)).metadata.topics
        assert (topic.offers, topic.message_count) == ((), 1)
    with pytest.raises(BagError, match="nothing in"):
        recover(foreign_file(tmp_path / "without_schema.mcap", schema=9))


def test_refusals(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "run_0.mcap.zstd").touch()  # compressed by rosbag2, not by MCAP
    (tmp_path / "text.mcap").write_text("not an MCAP file")
    write_bag(tmp_path / "run", count=1)
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "run" / "run_0.mcap").read_bytes()[:8])
    for bag, out, message in (
        ("nowhere", None, "does not exist"),
        ("empty", None, "contains no .mcap file.*ros2 bag convert"),
        ("text.mcap", None, "not an MCAP file"),
        ("cut.mcap", None, "nothing in .*cut.mcap can be recovered"),
        ("run", "empty", "exists already"),
        ("run", "text.mcap/x", "cannot be created"),
    ):
        with pytest.raises(BagError, match=message):
            recover(tmp_path / bag, tmp_path / out if out else None)
    assert sorted(os.listdir(tmp_path)) == ["cut.mcap", "empty", "run", "text.mcap"]


def test_the_bag_of_a_run_is_found_in_its_folder(tmp_path, monkeypatch):
    write_bag(tmp_path / "run" / "bag", count=2)
    assert find_bag(tmp_path / "run") == tmp_path / "run" / "bag"
    assert recover(tmp_path / "run").target == tmp_path / "run" / "bag_recovered"
    monkeypatch.chdir(tmp_path / "run" / "bag")
    shutil.rmtree(tmp_path / "run" / "bag_recovered")
    assert recover(".").target.resolve() == tmp_path / "run" / "bag_recovered"


def test_the_last_seconds_of_a_bag_without_chunks(tmp_path):
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start("ros2", "another")
        writer.register_schema(STRING, "ros2msg", message_definition(STRING).text.encode())
        channel = writer.register_channel("/a", "cdr", 1)
        for i in range(101):
            writer.add_message(channel, 10**9 + 10**8 * i, numbered(i), 0)
        writer.finish()
    kept = recover(tmp_path / "run.mcap", last=2.0).target
    assert [m.data for m in read_messages(kept)] == [numbered(i) for i in range(80, 101)]


def test_the_last_seconds_are_those_received_last_and_all_of_a_latched_topic(tmp_path):
    with BagWriter(tmp_path / "run", chunk_size=2000) as writer:
        latched = writer.add_channel("/latched", STRING, offers=[LATCHED], type_hash=STRING_HASH)
        ticks = writer.add_channel("/ticks", STRING, type_hash=STRING_HASH)
        writer.write(latched, numbered(0), 10**9, 10**9)
        for i in range(101):
            writer.write(ticks, numbered(i), 10**9 + 10**8 * i, 0)
    for out, last in (("endless", float("inf")), ("huge", 1e300)):
        assert recover(tmp_path / "run", tmp_path / out, last=last).metadata.message_count == 102
    expected = [("/latched", numbered(0)), *(("/ticks", numbered(i)) for i in range(80, 101))]
    file = tmp_path / "run" / "run_0.mcap"
    for out in ("whole", "damaged"):
        kept = recover(tmp_path / "run", tmp_path / out, last=2.0).target
        assert [(m.topic, m.data) for m in read_messages(kept)] == expected
        with file.open("rb") as stream:
            chunk = make_reader(stream).get_summary().chunk_indexes[1]
        damage(file, lambda data, at=chunk.chunk_start_offset: data.__setitem__(at + 8, 1))


def test_poses_that_were_accepted_stay_in_force_beside_the_last_seconds(tmp_path):
    poses = ["/accepted/desired_pose", "/left/accepted/desired_pose"]
    topics = [*poses, "/accepted/user_grasp_force"]
    with BagWriter(tmp_path / "run", chunk_size=2000) as writer:
        channels = [writer.add_channel(topic, STRING, type_hash=STRING_HASH) for topic in topics]
        for i in range(3):
            for channel in channels[: 3 if i != 1 else 2]:
                writer.write(channel, numbered(10 * channel + i), 10**9 * (1 + 4 * i), 0)
    kept = recover(tmp_path / "run", last=2.0)
    assert summarize(kept.target).counts == dict(zip(topics, (3, 3, 1), strict=True))
    force = [m for m in read_messages(kept.target) if m.topic == topics[2]]
    assert [m.log_time for m in force] == [9 * 10**9]
