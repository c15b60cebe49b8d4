# SPDX-License-Identifier: Apache-2.0
"""A bag that another process writes is the bag that this one would write."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tactile_hand_ros.bag.reader import read_raw
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import writer_process
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
