# SPDX-License-Identifier: Apache-2.0
"""Fuzzing of running nodes: damaged bytes on every input.

The bytes of a message are damaged after its header, so that nodes accept its type. Plausible values
are covered by `make study NAME=faults`. Service requests are excluded, because the middleware
trusts their lengths; see docs/how-to/security.md. `test/property/test_hostile_*.py` fuzz the
readers of messages and files without nodes.
"""

from __future__ import annotations

import random
import struct
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import serialize_message

from studies.faults.running_hand import RunningHand
from tactile_hand_ros import names
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import message_class
from tactile_hand_ros.scenario.scenario import NODES, load_scenario

GROWTH = 50 * 2**20
"""Maximum growth of a process's memory [B]."""

_CHANGES = {
    "duration": 86400.0,
    "plant.rate": 250.0,
    "plant.autostart": False,
    "targets": [],
}
_KEPT = 5000  # events
_BURST = 20  # inputs between two checks of the hand
_STILL = 20.0  # s without a tick that count as a hang; a busy machine is none
_FAR = 0.05  # m that the object may move under attack at rest
_PAUSE = 0.02  # s, at least, between two bursts
_ROOM = 1000  # maximum bytes of a damaged message after its header
_WORDS = (
    *(b"", b"\0", b"\xff", bytes(4), bytes(8), b"\xff" * 4, b"\xff" * 8, b"\xff\xff\xff\x7f"),
    *(struct.pack("<d", value) for value in (1e308, -1e308, float("nan"), float("inf"), 5e-324)),
    *(struct.pack("<I", value) for value in (1, 2**16, 2**20, 2**31, 2**32 - 1)),
)


@dataclass
class Report:
    """Result of fuzzing.

    Attributes:
        inputs: Number of sent inputs.
        finding: The first failure, which ends the attack; empty without one.
        growth: Largest growth of a process's memory [B].
        grew_most: The node with that growth.
    """

    inputs: int = 0
    finding: str = ""
    growth: int = 0
    grew_most: str = ""


def damaged(data: bytes, chance: random.Random) -> bytes:
    """Return bytes with one to five damages: overwrite, insert, delete, repeat or truncate."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 5)):
        at, size = chance.randint(0, len(changed)), chance.randint(0, 40)
        word = chance.choice(_WORDS) or chance.randbytes(size)
        what = chance.randrange(5)
        if what == 0:
            changed[at : at + len(word)] = word
        elif what == 1:
            changed[at:at] = word
        elif what == 2:
            del changed[at : at + size]
        elif what == 3:
            changed[at:at] = changed[max(0, at - size) : at] * chance.randint(1, 4)
        else:
            del changed[at:]
    return bytes(changed[:_ROOM])


def _inputs(hand: RunningHand) -> dict[str, Any]:
    """Return every topic that a node of the hand subscribes to, with its type."""
    readers = hand.node.get_subscriptions_info_by_topic
    return {
        topic: message_class(types[0])
        for topic, types in hand.node.get_topic_names_and_types()
        if topic not in names.OF_ALL and any(end.node_name in NODES for end in readers(topic))
    }


def fuzz_nodes(seconds: float, seed: int) -> Report:
    """Fuzz running nodes for some seconds, or until the first finding.

    The same seed gives the same inputs on every machine.
    """
    scenario = load_scenario("paper", _CHANGES)
    report = Report()
    with (
        tempfile.TemporaryDirectory() as scratch,
        RunningHand(scenario, Path(scratch), composed=False) as hand,
    ):
        hand.begin()
        hand.wait_for_time(0.3)
        inputs, start = _inputs(hand), hand.positions(hand.events)[1][-1]
        good = {topic: bytes(serialize_message(kind())) for topic, kind in inputs.items()}
        publishers = {
            topic: hand.node.create_publisher(kind, topic, qos.USER_DEPTH)
            for topic, kind in inputs.items()
        }
        memory = _memory(hand)
        end = time.monotonic() + seconds
        while time.monotonic() < end and not report.finding:
            for number in range(report.inputs, report.inputs + _BURST):
                chance = random.Random(f"{seed}/{number}")
                topic = chance.choice(list(inputs))
                with suppress(_rclpy.RCLError):  # too long for a bounded type
                    publishers[topic].publish(good[topic][:4] + damaged(good[topic][4:], chance))
            report.inputs += _BURST
            report.finding = _wrong(hand, start)
            for name, now in _memory(hand).items():
                if now - memory[name] > report.growth:
                    report.growth, report.grew_most = now - memory[name], name
    return report


def _memory(hand: RunningHand) -> dict[str, int]:
    """Return the memory of the running processes by name [B]."""
    running = {name: p.pid for name, p in hand.processes.items() if p.returncode is None}
    return {name: int(psutil.Process(pid).memory_info().rss) for name, pid in running.items()}


def _wrong(hand: RunningHand, start: Any) -> str:
    """Return a finding about the hand at the next tick, empty without one."""
    sent, pause = time.monotonic(), threading.Event()
    while True:
        pause.wait(_PAUSE)
        del hand.events[:-_KEPT]
        for name, process in hand.processes.items():
            if process.returncode is not None:
                return f"crash: {name} exited with code {process.returncode}"
        _, seen = hand.positions(hand.since(sent))
        if len(seen):
            break
        if time.monotonic() - sent > _STILL:
            return f"hang: no tick for {_STILL:g} s"
    moved = float(np.linalg.norm(seen - start, axis=1).max())
    return f"unsafe motion: the object moved by {1e3 * moved:.0f} mm" if moved > _FAR else ""
