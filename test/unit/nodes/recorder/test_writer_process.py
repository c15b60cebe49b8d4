# SPDX-License-Identifier: Apache-2.0
"""A bag that another process writes is the bag that this one would write."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
import signal
from collections import Counter, deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from tactile_hand_ros.bag.reader import read_raw
from tactile_hand_ros.bag.recover import repair
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import writer_process
from tactile_hand_ros.nodes.recorder.bag_process import FRAME
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess

TYPE = "std_msgs/msg/Float64"
MESSAGE = b"\0\1\0\0" + bytes(8)


def started(folder: Path) -> WriterProcess:
    writer = WriterProcess()
    writer.begin(folder, compression="zstd")
    writer.check()
    return writer


def fill(writer: BagWriter | WriterProcess) -> None:
    writer.add_metadata("origin", {"a": "b"})
    one, two = (writer.add_channel(topic, TYPE) for topic in ("/one", "/two"))
    for i in range(3000):
        writer.write(one if i % 3 else two, MESSAGE + i.to_bytes(4, "little"), 10 + i, 5 + i)
    writer.flush()
    writer.custom_data["lost_messages"] = "0"
    writer.close()


def test_the_bag_is_the_same_to_the_byte(tmp_path: Path) -> None:
    here, there = tmp_path / "here" / "bag", tmp_path / "there" / "bag"
    fill(BagWriter(here, compression="zstd"))
    other = started(there)
    fill(other)
    assert (there / "bag_0.mcap").read_bytes() == (here / "bag_0.mcap").read_bytes()
    assert (there / "metadata.yaml").read_text() == (here / "metadata.yaml").read_text()
    assert (other.message_count, other.bytes_received) == (3000, 3000 * 16)


def test_a_folder_that_exists_is_refused(tmp_path: Path) -> None:
    writer = WriterProcess()
    writer.begin(tmp_path)
    with pytest.raises(BagError, match="exists already"):
        writer.check()


def test_what_finds_no_room_is_counted_as_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rest is in the bag, in order, as soon as the process goes on."""
    monkeypatch.setattr(writer_process, "_MOST_WAITING", 1 << 20)
    writer = started(tmp_path / "bag")
    os.kill(writer.process_id, signal.SIGSTOP)
    channel = writer.add_channel("/one", TYPE)
    for i in range(400):
        writer.write(channel, MESSAGE + i.to_bytes(4, "little") + bytes(10_000), i, i)
        writer.send()
    assert 0 < writer.lost[channel] < 300
    os.kill(writer.process_id, signal.SIGCONT)
    writer.close()
    numbers = [int.from_bytes(m.data[12:16], "little") for m in read_raw(tmp_path / "bag")]
    assert numbers == list(range(400 - writer.lost[channel]))


def test_64_mib_may_wait_for_a_process_that_does_not_read(tmp_path: Path) -> None:
    writer, piece = started(tmp_path / "bag"), bytes(1 << 20)
    os.kill(writer.process_id, signal.SIGSTOP)
    channel = writer.add_channel("/one", TYPE)
    while not writer.lost[channel]:
        writer.write(channel, piece, 0, 0)
        writer.send()
    assert 64 << 20 < writer._waiting_bytes <= (65 << 20) + 1000
    os.kill(writer.process_id, signal.SIGKILL)
    with pytest.raises(BagError):
        writer.close()


def test_a_process_that_has_died_is_an_error_with_advice(tmp_path: Path) -> None:
    writer = started(tmp_path / "bag")
    os.kill(writer.process_id, signal.SIGKILL)
    channel = writer.add_channel("/one", TYPE)
    with pytest.raises(BagError, match="tactile-hand recover"):
        while True:
            writer.write(channel, bytes(100_000), 0, 0)
            writer.send()
    assert not writer.is_open


def test_the_process_may_be_late_ends_with_the_pipe_and_keeps_what_it_was_sent(
    tmp_path: Path,
) -> None:
    """Without a close the bag is broken, and its messages are there; signals do not end it."""
    folder, before = tmp_path / "bag", os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        writer = started(folder)
    finally:
        os.sched_setaffinity(0, before)
    process = writer._process
    assert os.sched_getscheduler(process.pid) == os.SCHED_BATCH
    assert os.sched_getaffinity(process.pid) == set(range(os.cpu_count() or 1))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(process.pid, number)
    assert writer.is_open
    channel = writer.add_channel("/one", TYPE)
    writer.write(channel, MESSAGE, 1, 2)
    writer.send()
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(20.0) == 1
    assert not (folder / "metadata.yaml").exists()
    repair(folder)
    (message,) = read_raw(folder)
    assert (message.data, message.log_time) == (MESSAGE, 1)


def test_a_process_that_closes_its_bag_ends_well_and_one_without_orders_does_not(
    tmp_path: Path,
) -> None:
    writer, idle = started(tmp_path / "bag"), WriterProcess()
    assert idle._process.stdin is not None
    idle._process.stdin.close()
    writer.close()
    assert not writer.is_open and writer._process.wait(20.0) == 0
    assert idle._process.wait(20.0) == 1


@pytest.fixture
def piped(tmp_path: Path) -> Iterator[tuple[WriterProcess, int, int]]:
    """A writer without a process, and the ends of its pipes: what it sends, what it is told."""
    sent, pipe = os.pipe()
    answers, replies = os.pipe()
    os.set_blocking(pipe, False)
    os.set_blocking(sent, False)
    writer = WriterProcess.__new__(WriterProcess)
    writer._pipe, writer._answers, writer.folder = pipe, answers, tmp_path / "bag"
    writer._frames, writer._waiting, writer._waiting_bytes = [], deque(), 0
    writer.message_count = writer.bytes_received = 0
    writer.lost, writer.is_open = Counter(), True
    yield writer, sent, replies
    for number in (sent, pipe, answers, replies):
        with contextlib.suppress(OSError):
            os.close(number)


Piped = tuple[WriterProcess, int, int]


def test_what_does_not_fit_into_the_pipe_waits_and_follows_in_order(piped: Piped) -> None:
    writer, sent, _ = piped
    pieces = [bytes([number]) * 50_000 for number in range(3)]
    for number, piece in enumerate(pieces):
        writer.write(7, piece, number, 2 * number)
    assert (writer.message_count, writer.bytes_received) == (3, 150_000)
    expected = b"".join(
        FRAME.pack(7, 50_000, number, 2 * number) + piece for number, piece in enumerate(pieces)
    )
    writer.send()
    got = os.read(sent, 1 << 20)
    assert 0 < len(got) < len(expected) and writer._waiting_bytes == len(expected) - len(got)
    while writer._waiting:
        writer.send()
        got += os.read(sent, 1 << 20)
    assert got == expected and writer._waiting_bytes == 0 and writer._frames == []
    writer.send()
    with pytest.raises(BlockingIOError):
        os.read(sent, 1)


def test_an_answer_may_come_in_pieces(piped: Piped, monkeypatch: pytest.MonkeyPatch) -> None:
    writer, _, replies = piped
    monkeypatch.setattr(writer_process, "_PIPE_SIZE", 3)
    os.write(replies, pickle.dumps({"a": list(range(50))}))
    assert writer._answer() == {"a": list(range(50))}
    os.write(replies, pickle.dumps(BagError("the disk is full.")))
    with pytest.raises(BagError, match=r"the disk is full\."):
        writer._answer()


def test_without_an_answer_it_says_why(piped: Piped, monkeypatch: pytest.MonkeyPatch) -> None:
    writer, sent, replies = piped
    assert writer_process._PATIENCE == 30.0
    monkeypatch.setattr(writer_process, "_PATIENCE", 0.01)
    with pytest.raises(BagError, match="has not answered for 0.* s; `tactile-hand recover"):
        writer.check()
    os.write(replies, pickle.dumps(None))
    os.close(sent)
    writer.write(1, b"x", 0, 0)
    with pytest.raises(BagError, match="was not written to its end"):
        writer.send()
    assert not writer.is_open
    os.close(replies)
    with pytest.raises(BagError, match="has ended; run `tactile-hand recover"):
        writer._received()


def test_the_pipe_holds_a_mebibyte_and_blocks_no_tick(tmp_path: Path) -> None:
    writer = started(tmp_path / "bag")
    assert fcntl.fcntl(writer._pipe, fcntl.F_GETPIPE_SZ) == 1 << 20
    assert not os.get_blocking(writer._pipe)
    assert os.getsid(writer.process_id) == writer.process_id
    assert (writer.message_count, writer.bytes_received, writer.lost) == (0, 0, {})
    writer.close()
    assert not Path(f"/proc/{writer.process_id}").exists()
    with pytest.raises(OSError, match="Bad file"):
        os.fstat(writer._answers)
