# SPDX-License-Identifier: Apache-2.0
"""Kill recorders at random moments and recover what they wrote."""

from __future__ import annotations

import signal
import struct
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import Int64

from tactile_hand_ros.bag.reader import read_raw, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.ros.middleware import use_sockets
from tactile_hand_ros.ros.processes import CapturedProcess, start_executable, wait_until

TOPICS = ("/left/number", "/right/number")
RATE = 500.0  # Hz on each topic
_ENTRY = struct.Struct("<qq")


@dataclass(frozen=True)
class Outcome:
    """What came of one kill.

    Attributes:
        recovered: Number of messages in the recovered bag.
        lost: Time between the last recovered message of a topic and the kill, s; the longest.
        unsaved: Messages that were sent until `bound` s before the kill and are not in the bag.
        gaps: Missing numbers between the first and the last recovered one.
    """

    recovered: int
    lost: float
    unsaved: int
    gaps: int


def talk(diary: Path) -> None:
    """Publish 0, 1, 2, ... until killed, and write down number and time of each."""
    use_sockets()
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node("talker", context=context)
    publishers = [node.create_publisher(Int64, topic, QoSProfile(depth=2000)) for topic in TOPICS]
    period = 1.0 / RATE
    begin = time.monotonic()
    number = 0
    with diary.open("wb", buffering=0) as file:
        while True:
            data = serialize_message(Int64(data=number))
            for publisher in publishers:
                publisher.publish(data)
            file.write(_ENTRY.pack(number, time.time_ns()))
            number += 1
            signal.sigtimedwait([], max(0.0, begin + number * period - time.monotonic()))


@contextmanager
def talker(diary: Path) -> Iterator[None]:
    """Publish in a process of its own."""
    process = CapturedProcess([sys.executable, __file__, "talk", diary])
    with process:
        wait_until(lambda: diary.exists() and diary.stat().st_size > 0, 30.0)
        yield


def kill(folder: Path, diary: Path, delay: float, bound: float) -> Outcome:
    """Record, kill the recorder some time after its first message, and recover.

    Args:
        folder: For the bag.
        diary: What the talker writes.
        delay: Time from the first recorded chunk to the kill, s.
        bound: What may be lost, s.
    """
    bag = folder / "bag"
    # Chunks that never fill: what is on the disk is there because its time had come.
    values = (f"output:={bag}", "topics:=['/(left|right)/number']", "chunk_size:=16777216")
    flags = [word for value in values for word in ("-p", value)]
    with start_executable("recorder", "--ros-args", *flags) as recorder:
        wait_until(lambda: recorder.returncode is not None or _has_begun(bag), 30.0)
        assert recorder.returncode is None, recorder.stderr
        signal.sigtimedwait([], delay)
        writers = psutil.Process(recorder.pid).children()
        killed = time.time_ns()
        recorder.send(signal.SIGKILL)
        assert recorder.wait() == -signal.SIGKILL
        psutil.wait_procs(writers, 30.0)
    return _outcome(bag, diary, killed, bound)


def _has_begun(bag: Path) -> bool:
    """Return whether all topics are on the disk."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            counts = summarize(recover(bag, Path(folder) / "bag").target).counts
        except BagError:
            return False
    return all(counts.get(topic) for topic in TOPICS)


def _outcome(bag: Path, diary: Path, killed: int, bound: float) -> Outcome:
    before = {file: file.read_bytes() for file in bag.iterdir()}
    target = recover(bag).target
    assert before == {file: file.read_bytes() for file in bag.iterdir()}, "the original changed"
    entries = np.frombuffer(diary.read_bytes()[: 16 * (diary.stat().st_size // 16)], dtype="<i8")
    numbers, times = entries.reshape(-1, 2).T
    numbers, times = numbers[times <= killed], times[times <= killed]
    recovered, lost, unsaved, gaps = 0, 0.0, 0, 0
    for topic in TOPICS:
        got = np.array([number_in(m.data) for m in read_raw(target, [topic])], dtype=np.int64)
        assert len(got), f"nothing of {topic} was recovered"
        recovered += len(got)
        gaps += int((np.diff(got) - 1).sum())
        later = times[numbers > got[-1]]
        lost = max(lost, 1e-9 * float(killed - later[0]) if len(later) else 0.0)
        unsaved += int((later < killed - bound * 1e9).sum())
    assert summarize(target).message_count == recovered
    return Outcome(recovered, lost, unsaved, gaps)


def number_in(data: bytes) -> int:
    """Return the number in the CDR of an Int64."""
    return int.from_bytes(data[4:12], "little", signed=True)


if __name__ == "__main__":
    talk(Path(sys.argv[2]))
