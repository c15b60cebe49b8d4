# SPDX-License-Identifier: Apache-2.0
"""A bag written by another process equals the one that this process would write."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.nodes.recorder import writer_process
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
from tactile_hand_ros.ros.processes import wait_until

TYPE = "std_msgs/msg/Float64"
MESSAGE = b"\0\1\0\0" + bytes(8)


def started(folder: Path, **options: Any) -> WriterProcess:
    return WriterProcess(folder, compression="zstd", **options)


def fill(writer: BagWriter | WriterProcess) -> None:
    one, two = (writer.add_channel(topic, TYPE) for topic in ("/one", "/two"))
    for i in range(3000):
        writer.write(one if i % 3 else two, MESSAGE + i.to_bytes(4, "little"), 10 + i, 5 + i)
    writer.flush()
    writer.custom_data["lost_messages"] = "0"
    writer.close()


def test_the_bag_is_the_same_to_the_byte(tmp_path):
    here, there = tmp_path / "here" / "bag", tmp_path / "there" / "bag"
    fill(BagWriter(here, compression="zstd"))
    other = started(there)
    fill(other)
    assert (there / "bag_0.mcap").read_bytes() == (here / "bag_0.mcap").read_bytes()
    assert (there / "metadata.yaml").read_text() == (here / "metadata.yaml").read_text()
    assert (other.message_count, other.bytes_received, other.lost) == (3000, 3000 * 16, {})
    assert not other.is_open and not psutil.pid_exists(other.process.pid)


def test_a_pipe_that_may_not_grow_is_used_as_it_is(tmp_path, monkeypatch):
    def refuse(*_: int) -> None:
        raise PermissionError

    kernel = SimpleNamespace(fcntl=refuse, F_SETPIPE_SZ=writer_process.fcntl.F_SETPIPE_SZ)
    monkeypatch.setattr(writer_process, "fcntl", kernel)
    fill(started(tmp_path / "bag", custom_data={"scenario": "x" * 200_000}))
    assert len(list(read_messages(tmp_path / "bag"))) == 3000


def test_what_finds_no_room_is_counted_as_lost(tmp_path, monkeypatch):
    """A process that does not read causes no delay; all other messages are in the bag, in order."""
    assert writer_process._MAX_WAITING == 64 << 20
    monkeypatch.setattr(writer_process, "_MAX_WAITING", 1 << 20)
    writer = started(tmp_path / "bag")
    process = psutil.Process(writer.process.pid)
    process.suspend()
    wait_until(lambda: process.status() == psutil.STATUS_STOPPED, 10.0)
    channel = writer.add_channel("/one", TYPE)
    for i in range(400):
        writer.write(channel, MESSAGE + i.to_bytes(4, "little") + bytes(10_000), i, i)
        writer.send()
    assert 0 < writer.lost[channel] < 300
    process.resume()
    writer.close()
    numbers = [int.from_bytes(m.data[12:16], "little") for m in read_messages(tmp_path / "bag")]
    assert numbers == list(range(400 - writer.lost[channel]))


def test_a_process_that_has_died_is_an_error_with_advice(tmp_path):
    writer = started(tmp_path / "bag")
    os.kill(writer.process.pid, signal.SIGKILL)
    channel = writer.add_channel("/one", TYPE)
    with pytest.raises(BagError, match="tactile-hand recover"):
        while True:
            writer.write(channel, bytes(100_000), 0, 0)
            writer.send()
    assert not writer.is_open
    count = writer.message_count
    writer.write(channel, MESSAGE, 0, 0)
    assert (writer.message_count, writer.lost[channel]) == (count, 1)


def test_a_disk_that_refuses_the_data_is_the_reason_given(tmp_path):
    writer = started(tmp_path / "bag")
    psutil.Process(writer.process.pid).rlimit(psutil.RLIMIT_FSIZE, (10_000, 10_000))
    channel = writer.add_channel("/one", TYPE)

    def fails() -> bool:
        writer.write(channel, os.urandom(1000), 0, 0)
        writer.flush()
        writer.send()
        return False

    with pytest.raises(BagError, match="File too large; free some space and run `tactile-hand rec"):
        wait_until(fails)


SENDER = f"""
import os, signal, sys
from pathlib import Path
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
writer = WriterProcess(Path(sys.argv[1]))
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    os.kill(writer.process.pid, number)
writer.write(writer.add_channel('/one', {TYPE!r}), {MESSAGE!r}, 1, 2)
writer.send()
print(writer.process.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_sender_has_sent_can_be_recovered(tmp_path):
    """The process ends when the pipe is closed, not by a signal."""
    folder = tmp_path / "bag"
    sender = subprocess.run([sys.executable, "-c", SENDER, folder], stdout=subprocess.PIPE)
    assert sender.returncode == -signal.SIGKILL
    wait_until(lambda: not psutil.pid_exists(int(sender.stdout)))
    assert not (folder / "metadata.yaml").exists()
    (message,) = read_messages(recover(folder).target)
    assert (message.data, message.log_time) == (MESSAGE, 1)


def test_it_gives_up_the_priority_of_the_hand_before_it_imports_anything(tmp_path, monkeypatch):
    """A module that replaces a library records how it is imported."""
    (tmp_path / "mcap").mkdir()
    (tmp_path / "mcap" / "__init__.py").write_text(
        "import os\n"
        f"with open({str(tmp_path / 'seen')!r}, 'w') as file:\n"
        "    print(os.sched_getscheduler(0), file=file)\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    with pytest.raises(BagError):  # it ends, because mcap is only this file
        WriterProcess(tmp_path / "bag")
    assert int((tmp_path / "seen").read_text()) == os.SCHED_BATCH
