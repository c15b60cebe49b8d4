# SPDX-License-Identifier: Apache-2.0
"""Bags that were cut off or damaged: what is whole comes back, nothing is made up or destroyed."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import struct
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import lz4.frame
import pytest
import yaml
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as ForeignWriter
from rosbags.typesys import Stores, get_typestore

from tactile_hand_ros.bag import recover as recover_module
from tactile_hand_ros.bag.qos import OfferedQos, parse_qos, qos_text
from tactile_hand_ros.bag.reader import read_raw, summarize
from tactile_hand_ros.bag.recover import continue_bag, is_whole, recover, repair
from tactile_hand_ros.bag.salvage import MAGIC, Tally, salvage
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError

STRING = "std_msgs/msg/String"
COUNT = 400


def payload(number: int) -> bytes:
    """Return the CDR of a String, hard to compress."""
    data = f"{number} {hash((number, 'x')) ** 5}".encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def write_bag(folder: Path, compression: str = "zstd", count: int = COUNT) -> list[bytes]:
    """Write a bag of some chunks and return its messages."""
    sent = [payload(i) for i in range(count)]
    told = {"scenario": "name: x\n"}
    with BagWriter(folder, compression, chunk_size=2000, custom_data=told) as writer:
        channels = [
            writer.add_channel(name, STRING, offers=[OfferedQos(durability="transient_local")])
            for name in ("/a", "/b")
        ]
        for i, data in enumerate(sent):
            writer.write(channels[i % 2], data, 1000 + i, 900 + i)
    return sent


def cut(folder: Path, size: int) -> Path:
    """Cut the file of a bag to `size` bytes, as a killed recorder leaves it."""
    file = folder / f"{folder.name}_0.mcap"
    file.write_bytes(file.read_bytes()[:size])
    (folder / "metadata.yaml").unlink()
    return file


@pytest.fixture(scope="module", params=["none", "lz4", "zstd"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag to copy and cut."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    write_bag(folder, request.param)
    return folder


@settings(max_examples=25)
@given(share=st.floats(0.0, 1.0))
def test_cut_at_any_byte_the_front_comes_back(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    """Messages are a gapless front, at least all of the whole chunks; the original is untouched."""
    sent = [m.data for m in read_raw(whole)]
    folder = tmp_path_factory.mktemp("cut") / "run"
    shutil.copytree(whole, folder)
    size = round(share * (folder / "run_0.mcap").stat().st_size)
    file = cut(folder, size)
    before = file.read_bytes()
    recovery = recover(folder)
    assert file.read_bytes() == before and not (folder / "metadata.yaml").exists()
    got = [m.data for m in read_raw(recovery.target)]
    assert got == sent[: len(got)]
    assert len(got) == recovery.messages >= chunked(before)
    assert summarize(recovery.target).message_count == len(got)
    if got:
        assert summarize(recovery.target).custom_data["scenario"] == "name: x\n"


def chunked(data: bytes) -> int:
    """Return how many messages the whole chunks in the front of a file hold, by their indices."""
    at, count = 8, 0
    while at + 9 <= len(data):
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        at += 9 + length
        if data[at - length - 9] == 0x07 and at <= len(data):  # message index: entries of 16 bytes
            count += (length - 6) // 16
    return count


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_half_a_chunk_is_used(tmp_path: Path, compression: str) -> None:
    """One large chunk, cut in the middle, gives about half of its messages."""
    folder = tmp_path / "run"
    with BagWriter(folder, compression=compression, chunk_size=2**24) as writer:
        channel = writer.add_channel("/a", STRING)
        for i in range(20_000):
            writer.write(channel, payload(i), i, i)
    cut(folder, (folder / "run_0.mcap").stat().st_size // 2)
    recovery = recover(folder)
    assert 6_000 < recovery.messages < 14_000
    assert recovery.left > 0 and str(recovery.left) in recovery.sentence
    got = [m.data for m in read_raw(recovery.target)]
    assert got == [payload(i) for i in range(len(got))]


def test_damaged_chunk_is_left_out_and_the_rest_is_kept(tmp_path: Path) -> None:
    """No message is made up of wrong bytes."""
    sent = write_bag(tmp_path / "run", "none")
    file = tmp_path / "run" / "run_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(sent[100]) + 10] ^= 1
    file.write_bytes(data)
    recovery = recover(tmp_path / "run", tmp_path / "out")
    got = {m.data for m in read_raw(recovery.target)}
    assert got < set(sent) and sent[100] not in got
    assert len(got) > COUNT - 60 and recovery.left > 500


def test_zeros_at_the_end_are_no_records(tmp_path: Path) -> None:
    """A disk that lost power leaves them."""
    write_bag(tmp_path / "run")
    file = cut(tmp_path / "run", 9000)
    front = recover(tmp_path / "run", tmp_path / "front").messages
    file.write_bytes(file.read_bytes() + bytes(5000))
    recovery = recover(tmp_path / "run", tmp_path / "out")
    assert recovery.messages == front > 0 and recovery.left >= 5000


def test_bag_of_others(tmp_path: Path) -> None:
    """What `rosbags` wrote, cut off; its schema is kept."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with ForeignWriter(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/talk", STRING, typestore=store)
        for i in range(30_000):
            writer.write(connection, i, payload(i))
    assert is_whole(tmp_path / "run")
    file = next((tmp_path / "run").glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 3 // 4])
    recovery = recover(file)
    assert recovery.target == file.with_name(f"{file.stem}_recovered")
    assert 10_000 < recovery.messages < 30_000
    with AnyReader([recovery.target]) as reader:
        assert reader.connections[0].msgdef.data == connection.msgdef.data
        got = [bytes(data) for _, _, data in reader.messages()]
    assert got == [payload(i) for i in range(len(got))]


def test_metadata_attachments_and_sequences_are_kept(tmp_path: Path) -> None:
    """A file of somebody who uses all of MCAP, without chunks."""
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="other")
        writer.add_metadata("mine", {"a": "b"})
        writer.add_attachment(1, 2, "photo.png", "image/png", b"png")
        schema = writer.register_schema("Thing", "jsonschema", b"{}")
        channel = writer.register_channel("/thing", "json", schema)
        writer.add_message(channel, 5, b"{}", 4, sequence=7)
        writer.finish()
    file.write_bytes(file.read_bytes()[:-20])
    recovery = recover(file, tmp_path / "out")
    with (tmp_path / "out" / "out_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "other"
        assert [a.data for a in reader.iter_attachments()] == [b"png"]
        assert [m.name for m in reader.iter_metadata()] == ["mine", "rosbag2"]
        [(_, found, message)] = list(reader.iter_messages())
    assert (found.message_encoding, message.sequence, message.publish_time) == ("json", 7, 4)
    assert recovery.metadata.topics[0].serialization_format == "json"


def test_split_bag_with_a_cut_last_file(tmp_path: Path) -> None:
    """All files come back under one metadata.yaml."""
    folder = tmp_path / "run"
    with BagWriter(folder, chunk_size=1000, max_size=5000) as writer:
        channel = writer.add_channel("/a", STRING)
        for i in range(500):
            writer.write(channel, payload(i), i, i)
    files = sorted(folder.glob("*.mcap"), key=lambda file: file.stat().st_mtime_ns)
    assert len(files) > 3
    files[-1].write_bytes(files[-1].read_bytes()[:1500])
    (folder / "metadata.yaml").unlink()
    recovery = recover(folder)
    whole = yaml.safe_load((recovery.target / "metadata.yaml").read_text())
    told = whole["rosbag2_bagfile_information"]
    assert len(told["relative_file_paths"]) == len(files)
    got = [m.data for m in read_raw(recovery.target)]
    assert got == [payload(i) for i in range(len(got))] and len(got) > 400


def test_in_place_keeps_the_broken_file(tmp_path: Path) -> None:
    """The folder opens under its own name, and a second repair finds nothing to do."""
    sent = write_bag(tmp_path / "run")
    file = cut(tmp_path / "run", 9000)
    broken = file.read_bytes()
    recovery = recover(tmp_path / "run", in_place=True)
    assert [kept.read_bytes() for kept in recovery.kept] == [broken]
    got = [m.data for m in read_raw(tmp_path / "run")]
    assert got == sent[: len(got)] and got
    assert is_whole(tmp_path / "run")
    assert continue_bag(tmp_path / "run") is None


def test_recorder_continues_its_own_broken_bag(tmp_path: Path) -> None:
    """Old and new messages are in one bag, the new ones in a file of their own."""
    folder = tmp_path / "run"
    sent = write_bag(folder)
    cut(folder, 9000)
    earlier = continue_bag(folder)
    assert earlier is not None
    with BagWriter(folder, earlier=earlier.metadata) as writer:
        channel = writer.add_channel("/a", STRING)
        for i in range(10):
            writer.write(channel, payload(i), 10**6 + i, 0)
    got = [m.data for m in read_raw(folder)]
    assert got == sent[: earlier.messages] + [payload(i) for i in range(10)]
    names = {file.name for file in folder.iterdir()}
    assert names == {"run_0.mcap", "run_0.mcap.broken", "run_1.mcap", "metadata.yaml"}


def test_bag_of_somebody_else_is_not_continued(tmp_path: Path) -> None:
    """A recorder may only touch what a recorder of this package wrote."""
    folder = tmp_path / "run"
    folder.mkdir()
    with (folder / "run_0.mcap").open("wb") as stream:
        Writer(stream).start(library="other")
    before = (folder / "run_0.mcap").read_bytes()
    with pytest.raises(BagError, match="broken bag of 'other'"):
        continue_bag(folder)
    assert (folder / "run_0.mcap").read_bytes() == before


def test_bag_that_is_being_recorded_is_left_alone(tmp_path: Path) -> None:
    """It is not broken, only unfinished."""
    writer = BagWriter(tmp_path / "run")
    with pytest.raises(BagError, match="is being recorded at this moment"):
        recover(tmp_path / "run")
    with pytest.raises(BagError, match="is being recorded at this moment"):
        continue_bag(tmp_path / "run")
    writer.close()


def test_refusals(tmp_path: Path) -> None:
    """One sentence each, and nothing is created or overwritten."""
    (tmp_path / "text.mcap").write_text("no bag at all")
    (tmp_path / "empty").mkdir()
    write_bag(tmp_path / "run")
    cut(tmp_path / "run", 9000)
    (tmp_path / "taken").mkdir()
    for match, arguments in (
        ("does not exist", (tmp_path / "nowhere",)),
        ("is not an MCAP file", (tmp_path / "text.mcap", tmp_path / "new")),
        ("holds no .mcap file", (tmp_path / "empty",)),
        ("exists already", (tmp_path / "run", tmp_path / "taken")),
    ):
        with pytest.raises(BagError, match=match):
            recover(*arguments)
    assert list((tmp_path / "taken").iterdir()) == []


def test_tally_knows_a_whole_file(tmp_path: Path) -> None:
    """Its counts are those of the bag."""
    write_bag(tmp_path / "run")
    tally = Tally()
    for _ in salvage(tmp_path / "run" / "run_0.mcap", tally):
        pass
    assert tally.intact and tally.by_topic == {"/a": COUNT // 2, "/b": COUNT // 2}
    assert tally.compression == "zstd"


def test_qos_text_is_read_back() -> None:
    """Also the numbers of older versions; nonsense gives nothing."""
    offers = (OfferedQos(), OfferedQos(reliability="best_effort", depth=7, deadline=1_500_000_000))
    assert parse_qos(qos_text(offers)) == offers
    old = qos_text(offers[:1]).replace("reliability: reliable", "reliability: 1")
    assert parse_qos(old) == offers[:1]
    assert parse_qos("") == parse_qos("- 1") == parse_qos("{") == ()
    wrong = [
        qos_text(offers[:1]).replace("reliability: reliable", "reliability: 9"),
        qos_text(offers[:1]).replace("depth: 0", "depth: .inf"),
    ]
    assert [parse_qos(text) for text in wrong] == [(), ()]


@pytest.mark.parametrize(("opcode", "lost"), [(0x03, 3), (0x04, 2)], ids=["schema", "channel"])
def test_what_nobody_has_introduced_is_left_out_and_counted(
    tmp_path: Path, opcode: int, lost: int
) -> None:
    """Without its schema a channel is lost, without its channel a message; others are not."""
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        for topic in ("/a", "/b"):
            schema = writer.register_schema(topic, "ros2msg", b"")
            channel = writer.register_channel(topic, "cdr", schema)
            for i in range(2):
                writer.add_message(channel, i, payload(i), i)
        writer.finish()
    records = list(cut_into_records(file.read_bytes()))
    gone = next(i for i, record in enumerate(records) if record[0] == opcode)
    orphans = [record for record in records[gone + 1 :] if record[0] in (0x04, 0x05)][:lost]
    file.write_bytes(MAGIC + b"".join(records[:gone] + records[gone + 1 :]) + MAGIC)
    recovery = recover(file, tmp_path / "out")
    assert [(m.topic, m.data) for m in read_raw(tmp_path / "out")] == [
        ("/b", payload(0)),
        ("/b", payload(1)),
    ]
    assert recovery.left == sum(len(record) - 9 for record in orphans)
    assert not is_whole(file)


def cut_into_records(data: bytes) -> Iterator[bytes]:
    """Yield the records between the magic at both ends of a file."""
    at = len(MAGIC)
    while at < len(data) - len(MAGIC):
        end = at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        yield data[at:end]
        at = end


def test_the_next_file_of_a_continued_bag_comes_after_all_that_are_there(tmp_path: Path) -> None:
    """Also where one in the middle is gone: files are read in the order of their numbers."""
    folder = tmp_path / "run"
    with BagWriter(folder, max_duration=1) as writer:
        channel = writer.add_channel("/a", STRING)
        for i in range(8):
            writer.write(channel, payload(i), i, i)
    (folder / "metadata.yaml").unlink()
    (folder / "run_1.mcap").unlink()
    before = {file: file.read_bytes() for file in folder.iterdir()}
    assert sorted(file.name for file in before) == ["run_0.mcap", "run_2.mcap", "run_3.mcap"]
    earlier = continue_bag(folder)
    assert earlier is not None
    with BagWriter(folder, earlier=earlier.metadata) as writer:
        assert writer.path == folder / "run_4.mcap"
        writer.write(writer.add_channel("/a", STRING), payload(8), 8, 8)
    assert {file: file.read_bytes() for file in before} == before
    assert [m.data for m in read_raw(folder)] == [payload(i) for i in (0, 1, 4, 5, 6, 7, 8)]


@pytest.mark.parametrize("part", ["compression", "size"])
def test_garbled_head_of_a_chunk_costs_that_chunk_only(tmp_path: Path, part: str) -> None:
    """Nobody knows what is in it, but all else is there; the loss is not exaggerated."""
    write_bag(tmp_path / "run")
    file = tmp_path / "run" / "run_0.mcap"
    data = bytearray(file.read_bytes())
    mark = b"\4\0\0\0zstd"
    name = data.index(mark, data.index(mark) + 1) + 4  # in the second chunk
    if part == "compression":
        data[name] ^= 1
    else:
        data[name - 9] ^= 0x80  # highest byte of the size
    file.write_bytes(data)
    recovery = recover(tmp_path / "run")
    assert COUNT - 60 < recovery.messages < COUNT
    assert 0 < recovery.left < 10_000


def test_odd_custom_data_is_left_out(tmp_path: Path) -> None:
    """A record that says nonsense does not keep the messages back."""
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("rosbag2", {"serialized_metadata": "custom_data: [1]"})
        writer.add_message(writer.register_channel("/a", "cdr", 0), 0, b"x", 0)
        writer.finish()
    assert recover(file, tmp_path / "out").messages == 1


@pytest.mark.parametrize("place", ["message", "index", "metadata", "other files", "count"])
def test_damage_behind_a_good_end_is_seen(tmp_path: Path, place: str) -> None:
    """What `recover` calls whole has every byte that matters."""
    sent = write_bag(tmp_path / "run", "none")
    assert is_whole(tmp_path / "run")
    file, metadata = tmp_path / "run" / "run_0.mcap", tmp_path / "run" / "metadata.yaml"
    data = bytearray(file.read_bytes())
    if place == "message":
        data[data.index(sent[200]) + 10] ^= 1
    elif place == "index":
        data[-60] ^= 1
    file.write_bytes(data)
    text = metadata.read_text()
    changed = {
        "metadata": "",
        "other files": text.replace("run_0", "run_1"),
        "count": text.replace(f"message_count: {COUNT}", "message_count: 7"),
    }
    metadata.write_text(changed.get(place, text))
    assert not is_whole(tmp_path / "run")
    assert recover(tmp_path / "run", in_place=True).messages > COUNT - 60
    assert is_whole(tmp_path / "run")


@pytest.mark.parametrize("where", ["metadata.yaml", "record", "file"])
def test_compression_of_rosbag2_is_refused(tmp_path: Path, where: str) -> None:
    """Its messages are not what they are declared to be, or its files would be passed over."""
    folder = tmp_path / "run"
    told = "compression_format: zstd\ncompression_mode: MESSAGE"
    with BagWriter(folder) as writer:
        if where == "record":
            writer.add_metadata("rosbag2", {"serialized_metadata": told})
        writer.write(writer.add_channel("/a", STRING), payload(0), 0, 0)
    metadata = folder / "metadata.yaml"
    if where == "metadata.yaml":
        text = metadata.read_text().replace('compression_format: ""', "compression_format: zstd")
        metadata.write_text(text.replace('compression_mode: ""', "compression_mode: MESSAGE"))
    elif where == "file":
        (folder / "run_1.mcap.zstd").write_bytes(b"(/")
    before = {file: file.read_bytes() for file in folder.iterdir()}
    for in_place in (False, True):
        with pytest.raises(BagError, match="decompress it with `ros2 bag convert`"):
            recover(folder, in_place=in_place)
    assert {file: file.read_bytes() for file in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("name", [".", "..", "../bag"])
def test_relative_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """The output is beside the bag from wherever one looks at it."""
    write_bag(tmp_path / "bag")
    cut(tmp_path / "bag", 9000)
    here = tmp_path / "bag" / "sub" if name == ".." else tmp_path / "bag"
    here.mkdir(exist_ok=True)
    monkeypatch.chdir(here)
    assert recover(name).target.resolve() == tmp_path / "bag_recovered"


def test_failure_leaves_nothing_behind(tmp_path: Path) -> None:
    """What cannot be read is told in a sentence; the next attempt finds the way free."""
    write_bag(tmp_path / "run")
    before = cut(tmp_path / "run", 9000).read_bytes()
    (tmp_path / "run" / "run_1.mcap").mkdir()  # no file, so it cannot be read
    for call in (recover, is_whole, repair):
        with pytest.raises(BagError, match="run_1.mcap"):
            call(tmp_path / "run")
    (tmp_path / "run" / "run_1.mcap").rmdir()
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run_0.mcap"]
    assert (tmp_path / "run" / "run_0.mcap").read_bytes() == before
    assert recover(tmp_path / "run").messages > 0


def test_full_disk_leaves_nothing_behind(tmp_path: Path) -> None:
    """Neither a draft nor a folder that blocks the next attempt; the broken bag is as it was."""
    write_bag(tmp_path / "run", "none", 20_000)
    size = (tmp_path / "run" / "run_0.mcap").stat().st_size
    cut(tmp_path / "run", size * 3 // 4)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size // 2, limits[1]))
    try:
        for call in (recover, repair):
            with pytest.raises(BagError, match="free some space"):
                call(tmp_path / "run")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run_0.mcap"]
    assert list(tmp_path.iterdir()) == [tmp_path / "run"]


def test_in_place_keeps_the_metadata_too(tmp_path: Path) -> None:
    """Somebody may have written into it by hand."""
    write_bag(tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").write_text("mine: [")
    recovery = recover(tmp_path / "run", in_place=True)
    assert [file.name for file in recovery.kept] == ["metadata.yaml.broken"]
    assert recovery.kept[0].read_text() == "mine: ["


@pytest.mark.parametrize("links", [True, False])
def test_however_often_a_bag_is_repaired_no_earlier_file_is_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    """Neither what earlier repairs kept nor what the user gave such a name, whatever it is."""
    if not links:  # as on exFAT

        def refuse(*_: object) -> None:
            raise PermissionError(errno.EPERM, "Operation not permitted")

        monkeypatch.setattr(os, "link", refuse)
    folder, elsewhere = tmp_path / "run", tmp_path / "elsewhere"
    sent = write_bag(folder)
    file, metadata = folder / "run_0.mcap", folder / "metadata.yaml"
    (folder / "run_0.mcap.broken1").write_text("the user's own")
    (folder / "run_0.mcap.broken2").symlink_to(elsewhere)  # to nothing
    (folder / "metadata.yaml.broken").mkdir()
    kept = {folder / "run_0.mcap.broken1": b"the user's own"}
    for cut_off in range(100, 104):
        file.write_bytes(file.read_bytes()[:-cut_off])
        metadata.write_text(f"repair {cut_off}: [")
        broken = [file.read_bytes(), metadata.read_bytes()]
        os.utime(file, (10**9, 10**9 + cut_off))
        recovery = recover(folder, in_place=True)
        assert recovery.kept[0].stat().st_mtime == 10**9 + cut_off
        assert not kept.keys() & set(recovery.kept)
        kept |= zip(recovery.kept, broken, strict=True)
        assert {path: path.read_bytes() for path in kept} == kept
        assert is_whole(folder)
    assert len(kept) == 9 and not elsewhere.exists()
    got = [m.data for m in read_raw(folder)]
    assert got == sent[: len(got)]


def test_half_a_copy_of_a_broken_file_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is full, without links: the broken file stays, and nothing looks like it."""
    write_bag(tmp_path / "run")
    before = cut(tmp_path / "run", 9000).read_bytes()

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(shutil, "copyfileobj", refuse)
    with pytest.raises(BagError, match="No space left on device"):
        repair(tmp_path / "run")
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run_0.mcap"]
    assert (tmp_path / "run" / "run_0.mcap").read_bytes() == before


def test_file_that_grows_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other recorders lock nothing; one that writes meanwhile loses nothing."""
    write_bag(tmp_path / "run")
    file = cut(tmp_path / "run", 9000)
    copy = recover_module.rewrite

    def copy_while_somebody_writes(source: Path, target: Path) -> object:
        done = copy(source, target)
        with source.open("ab") as stream:
            stream.write(b"more")
        return done

    monkeypatch.setattr(recover_module, "rewrite", copy_while_somebody_writes)
    with pytest.raises(BagError, match="has changed meanwhile"):
        repair(tmp_path / "run")
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["run_0.mcap"]
    assert file.stat().st_size == 9004


def packed_zeros(compression: str, size: int) -> bytes:
    """Return zeros, compressed without the size in the frame."""
    if compression == "lz4":
        return bytes(lz4.frame.compress(bytes(size), store_size=False))
    parameters = zstandard.ZstdCompressionParameters(write_content_size=0)
    return zstandard.ZstdCompressor(compression_params=parameters).compress(bytes(size))


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("announced", [2**20, 2**28 + 1, 2**39, 2**63])
def test_a_chunk_that_decompresses_to_too_much_is_left(
    tmp_path: Path, compression: str, announced: int
) -> None:
    """A file of kilobytes must not fill the memory; the messages around the chunk come back."""
    sent = write_bag(tmp_path / "run")
    file = tmp_path / "run" / "run_0.mcap"
    packed = packed_zeros(compression, 2**26)
    body = struct.pack("<QQQII", 0, 1, announced, 0, len(compression)) + compression.encode()
    body += struct.pack("<Q", len(packed)) + packed
    records = list(cut_into_records(file.read_bytes()))
    records.insert(4, struct.pack("<BQ", 0x06, len(body)) + body)
    file.write_bytes(MAGIC + b"".join(records) + MAGIC)
    tracemalloc.start()
    recovery = recover(tmp_path / "run")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert [m.data for m in read_raw(recovery.target)] == sent
    assert peak < 50e6
    assert recovery.left == (announced if announced <= 2**28 else len(packed))
    told = f"announces {announced} bytes, at most {2**28} are read"
    assert (told in recovery.sentence) == (announced > 2**28)


def test_a_record_that_is_too_large_is_passed_over(tmp_path: Path) -> None:
    """Its length is what a damaged byte makes of it; it is not read to find that out."""
    write_bag(tmp_path / "run")
    file = tmp_path / "run" / "run_0.mcap"
    with file.open("ab") as stream:
        stream.truncate(9000)
        stream.write(struct.pack("<BQ", 0x0C, 2**40))
        stream.truncate(2**33)  # a hole: it takes no place on the disk
    tracemalloc.start()
    tally = Tally()
    count = sum(1 for _ in salvage(file, tally))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count > 0 and not tally.complete
    assert peak < 50e6


def test_in_place_follows_no_link_that_somebody_planted(tmp_path: Path) -> None:
    """Neither under the name of a draft nor under that of a file to keep."""
    write_bag(tmp_path / "run")
    cut(tmp_path / "run", 9000)
    secret = tmp_path / "secret"
    secret.write_text("mine")
    for name in (".metadata.yaml", "metadata.yaml.broken", ".run_0.mcap", "run_0.mcap.broken"):
        (tmp_path / "run" / name).symlink_to(secret)
    assert recover(tmp_path / "run", in_place=True).messages > 0
    assert secret.read_text() == "mine"
    assert is_whole(tmp_path / "run")


def test_a_pipe_among_the_files_is_refused(tmp_path: Path) -> None:
    """It would be read for ever."""
    write_bag(tmp_path / "run")
    os.mkfifo(tmp_path / "run" / "run_1.mcap")
    for call in (recover, is_whole, repair):
        with pytest.raises(BagError, match="run_1.mcap is a folder, device, pipe"):
            call(tmp_path / "run")


def test_metadata_that_expands_to_much_keeps_no_message_back(tmp_path: Path) -> None:
    """Its texts are not expanded, its numbers not believed and its names not opened."""
    sent = write_bag(tmp_path / "run")
    links = "".join(f"k{i}: &k{i} [{', '.join([f'*k{i - 1}'] * 9)}]\n  " for i in range(1, 9))
    told = f"rosbag2_bagfile_information:\n  k0: &k0 [ha]\n  {links}custom_data: {{a: *k8}}\n"
    for text in (told, 50_000 * "[", "rosbag2_bagfile_information: {relative_file_paths: [../x]}"):
        (tmp_path / "run" / "metadata.yaml").write_text(text)
        recovery = recover(tmp_path / "run", tmp_path / "out")
        assert [m.data for m in read_raw(recovery.target)] == sent
        shutil.rmtree(tmp_path / "out")


def small(folder: Path, name: str = "") -> Path:
    """Write a bag of one message, cut off behind it; return its file, which may get a new name."""
    with BagWriter(folder, "none") as writer:
        writer.write(writer.add_channel("/a", STRING), payload(0), 0, 0)
        writer.flush()
        size = writer.path.stat().st_size
    file = cut(folder, size)
    return file.rename(folder / name) if name else file


def test_the_outcome_in_words(tmp_path: Path) -> None:
    folder, out = tmp_path / "run", tmp_path / "out"
    with BagWriter(folder, "none") as writer:
        channel, _ = writer.add_channel("/a", STRING), writer.add_channel("/silent", STRING)
        for number in range(3):
            writer.write(channel, payload(number), number, number)
    assert recover(folder, out).sentence == (
        f"recovered 3 messages on 1 topic to {out}; nothing was left behind; "
        f"{folder} was not touched"
    )
    shutil.rmtree(out)
    file = folder / "run_0.mcap"
    records = list(cut_into_records(file.read_bytes()))
    last = next(i for i, record in enumerate(records) if record[0] == 0x06)
    file.write_bytes(MAGIC + b"".join(records[: last + 1]) + b"\5\7")
    recovery = recover(folder, in_place=True)
    assert recovery.sentence == (
        f"recovered 3 messages on 1 topic to {folder}; 2 bytes could not be used; "
        f"the broken file is kept as {file}.broken, {folder / 'metadata.yaml'}.broken"
    )
    assert recovery.metadata.custom_data == {"recovered_bytes_left": "2"}


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_recovered_bag_is_compressed_as_the_broken_one(tmp_path: Path, compression: str) -> None:
    write_bag(tmp_path / "run", compression)
    cut(tmp_path / "run", 9000)
    tally = Tally()
    for _ in salvage(recover(tmp_path / "run").target / "run_recovered_0.mcap", tally):
        pass
    assert tally.messages and (tally.compression or "none") == compression


def test_a_bag_without_messages_comes_back_empty(tmp_path: Path) -> None:
    file = small(tmp_path / "run")
    file.write_bytes(file.read_bytes()[:100])
    recovery = recover(tmp_path / "run")
    assert recovery.messages == 0
    assert summarize(recovery.target).message_count == 0


def test_files_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """The tenth file comes after the second, and each message counts for its topic."""
    folder = tmp_path / "run"
    with BagWriter(folder, "none", max_duration=1) as writer:
        for number in range(24):
            if number in (0, 13):
                channel = writer.add_channel(f"/{number}", STRING)
            writer.write(channel, payload(number), number, number)
    assert (folder / "run_11.mcap").exists()
    (folder / "metadata.yaml").unlink()
    recovery = recover(folder)
    files = sorted(recovery.target.glob("*.mcap"), key=lambda file: int(file.stem.split("_")[-1]))
    assert [file.path for file in recovery.metadata.files] == [file.name for file in files]
    assert [m.data for file in files for m in read_raw(file)] == [payload(i) for i in range(24)]
    assert {topic.name: topic.message_count for topic in recovery.metadata.topics} == {
        "/0": 13,
        "/13": 11,
    }


def test_a_single_whole_file_is_whole(tmp_path: Path) -> None:
    write_bag(tmp_path / "run")
    file = tmp_path / "run" / "run_0.mcap"
    assert is_whole(file)
    file.write_bytes(file.read_bytes()[:-1])
    assert not is_whole(file)


@pytest.mark.parametrize("names", [[], ["run_0.mcap", "run_1.mcap"], "run_0.mcap"])
def test_a_bag_whose_metadata_name_other_files_is_not_whole(tmp_path: Path, names: object) -> None:
    write_bag(tmp_path / "run")
    metadata = tmp_path / "run" / "metadata.yaml"
    tree = yaml.safe_load(metadata.read_text())
    tree["rosbag2_bagfile_information"]["relative_file_paths"] = names
    metadata.write_text(yaml.safe_dump(tree))
    assert not is_whole(tmp_path / "run")


def test_a_file_cannot_be_repaired_in_place(tmp_path: Path) -> None:
    file = small(tmp_path / "run")
    with pytest.raises(BagError, match="run_0.mcap is a file, expected a folder to repair"):
        recover(file, in_place=True)


def test_a_folder_where_none_can_be_is_refused_and_missing_ones_are_made(tmp_path: Path) -> None:
    file = small(tmp_path / "run")
    with pytest.raises(BagError, match="cannot be created: Not a directory"):
        recover(tmp_path / "run", file / "out")
    assert recover(tmp_path / "run", tmp_path / "a" / "b" / "out").messages == 1


def test_the_bag_of_a_run_is_found_in_its_folder(tmp_path: Path) -> None:
    small(tmp_path / "run" / "bag")
    recovery = recover(tmp_path / "run")
    assert recovery.source == tmp_path / "run" / "bag"
    assert recovery.target == tmp_path / "run" / "bag_recovered" and recovery.messages == 1


def test_there_is_nothing_to_continue_without_a_broken_bag(tmp_path: Path) -> None:
    assert continue_bag(tmp_path / "absent") is None
    (tmp_path / "file").touch()
    assert continue_bag(tmp_path / "file") is None
    (tmp_path / "empty").mkdir()
    assert continue_bag(tmp_path / "empty") is None
    write_bag(tmp_path / "whole", count=1)
    assert continue_bag(tmp_path / "whole") is None
    small(tmp_path / "broken")
    assert continue_bag(tmp_path / "broken") is not None


def test_a_bag_that_lost_its_header_is_continued(tmp_path: Path) -> None:
    """Nothing marks it as another's."""
    file = small(tmp_path / "run")
    file.write_bytes(file.read_bytes()[:8])
    earlier = continue_bag(tmp_path / "run")
    assert earlier is not None and earlier.messages == 0


def test_the_draft_of_a_repair_that_was_interrupted_is_no_file_of_the_bag(tmp_path: Path) -> None:
    file = small(tmp_path / "run")
    draft = file.with_name(f".{file.name}")
    shutil.copy(file, draft)
    assert recover(tmp_path / "run").messages == 1
    assert repair(tmp_path / "run").messages == 1
    assert not draft.exists()


@pytest.mark.parametrize(
    ("form", "mode", "refused"),
    [
        ("zstd", "MESSAGE", True),
        ("zstd", "message", True),
        ("zstd", "", True),
        ("zstd", "FILE", False),
        ("zstd", "file", False),
        ("", "MESSAGE", False),
    ],
)
def test_only_messages_that_are_compressed_one_by_one_are_refused(
    tmp_path: Path, form: str, mode: str, refused: bool
) -> None:
    small(tmp_path / "run")
    tree = {"compression_format": form, "compression_mode": mode}
    text = yaml.safe_dump({"rosbag2_bagfile_information": tree})
    (tmp_path / "run" / "metadata.yaml").write_text(text)
    if refused:
        with pytest.raises(BagError, match="compressed by rosbag2"):
            recover(tmp_path / "run")
    else:
        assert recover(tmp_path / "run").messages == 1


def test_what_a_bag_says_of_itself_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Distribution and custom data of the last file count, and what is no text becomes one."""
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    file = tmp_path / "x.mcap"
    for said, distro, data in (
        ([], "kilted", {}),
        (["custom_data: {a: 1, b: c}"], "kilted", {"a": "1", "b": "c"}),
        (["ros_distro: iron"], "iron", {}),
        (["ros_distro: iron\ncustom_data: {a: b}", "custom_data: {c: d}"], "iron", {"c": "d"}),
        (["[1", "1"], "kilted", {}),
    ):
        with file.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            for text in said:
                writer.add_metadata("rosbag2", {"serialized_metadata": text})
            writer.add_metadata("rosbag2", {"other": "key"})
            writer.finish()
        metadata = recover(file, tmp_path / "out").metadata
        shutil.rmtree(tmp_path / "out")
        assert metadata.ros_distro == distro
        assert metadata.custom_data == data | {"recovered_bytes_left": "0"}
    monkeypatch.delenv("ROS_DISTRO")
    file.write_bytes(MAGIC)
    assert recover(file, tmp_path / "out").metadata.ros_distro == "jazzy"


def test_a_channel_that_is_announced_again_goes_on_counting(tmp_path: Path) -> None:
    """Others repeat schemas and channels in each chunk."""
    file = tmp_path / "x.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        channel = writer.register_channel("/a", "cdr", 0)
        writer.add_message(channel, 1, payload(1), 1)
        writer.finish()
    records = list(cut_into_records(file.read_bytes()))
    [announced] = [record for record in records if record[0] == 0x04][:1]
    [sent] = [record for record in records if record[0] == 0x05]
    file.write_bytes(MAGIC + b"".join(records[:1]) + 2 * (announced + sent) + MAGIC)
    recovery = recover(file, tmp_path / "out")
    [topic] = recovery.metadata.topics
    assert (topic.name, topic.type, topic.message_count) == ("/a", "", 2)
