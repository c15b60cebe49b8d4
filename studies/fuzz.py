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
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64

from studies.faults.running_hand import RunningHand
from tactile_hand_ros import names
from tactile_hand_ros.ros import qos
from tactile_hand_ros.scenario.scenario import load_scenario

GROWTH = 50 * 2**20
"""Maximum growth of a process's memory [B]."""

_CHANGES = {
    "duration": 86400.0,
    "plant.rate": 250.0,
    "plant.autostart": False,
    "targets": [],
}
_BURST = 20  # inputs between two checks of the hand
_STILL = 2.0  # s of processor time without a tick that count as a hang
_FAR = 0.05  # m that the object may move under attack at rest
_PAUSE = 0.02  # s between two bursts
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
    """Return every topic that a node subscribes to, with its type."""
    topics: dict[str, Any] = {
        names.JOINT_STATES: JointState,
        names.JOINT_COMMAND: JointState,
        names.TRUE_SLIP: JointState,
        names.GRIP_STATE: JointState,
        names.CONTACTS: PoseArray,
        names.TRUE_CONTACTS: PoseArray,
        names.GRASP_FORCE: WrenchStamped,
        names.DESIRED_POSE: PoseStamped,
        names.USER_GRASP_FORCE: Float64,
        names.JOINT_HOLD: Bool,
        names.TOUCH_REJECTED: Bool,
    }
    for finger in hand.fingers:
        for named in (names.wrench, names.true_wrench, names.optimal_force):
            topics[named(finger)] = WrenchStamped
    return topics


def fuzz_nodes(seconds: float, seed: int, folder: Path) -> Report:
    """Fuzz running nodes for some seconds, or until the first finding.

    The same seed gives the same inputs on every machine. The last inputs before a finding are
    written to the folder.
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
            topic: hand.node.create_publisher(kind, topic, qos.user_qos())
            for topic, kind in inputs.items()
        }
        processes = {name: psutil.Process(p.pid) for name, p in hand.processes.items()}
        memory = {name: process.memory_info().rss for name, process in processes.items()}
        end = time.monotonic() + seconds
        while time.monotonic() < end and not report.finding:
            sent = []
            for number in range(report.inputs, report.inputs + _BURST):
                chance = random.Random(f"{seed}/{number}")
                topic = chance.choice(list(inputs))
                data = good[topic][:4] + damaged(good[topic][4:], chance)
                with suppress(_rclpy.RCLError):  # too long for a bounded type
                    publishers[topic].publish(data)
                    sent.append(f"{topic} {data.hex()}")
            report.inputs += _BURST
            _wait(hand)
            report.finding = _wrong(hand, processes, start)
            _note_growth(report, processes, memory)
    if report.finding:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{seed}-{report.inputs}.txt").write_text("\n".join(sent), encoding="utf-8")
    return report


def _note_growth(
    report: Report, processes: dict[str, psutil.Process], memory: dict[str, int]
) -> None:
    for name, process in processes.items():
        with suppress(psutil.NoSuchProcess):
            grown = process.memory_info().rss - memory[name]
            if grown > report.growth:
                report.growth, report.grew_most = grown, name


def _wait(hand: RunningHand) -> None:
    until = time.monotonic() + _PAUSE
    hand.wait(lambda: time.monotonic() > until, "the next burst")
    hand.forget_but(5000)


def _next_ticks(hand: RunningHand, processes: dict[str, psutil.Process]) -> Any:
    """Return the latest positions of the object; none if a node hangs.

    A busy machine is no hang. The criterion is processor time of a node without a tick, or ten
    times as much wall time.
    """
    before = {name: sum(p.cpu_times()[:2]) for name, p in processes.items()}
    begin = time.monotonic()
    while True:
        _, seen = hand.positions(hand.since(begin - _STILL))
        worked = max(sum(p.cpu_times()[:2]) - before[name] for name, p in processes.items())
        if len(seen) or worked > _STILL or time.monotonic() - begin > 10.0 * _STILL:
            return seen
        _wait(hand)


def _wrong(hand: RunningHand, processes: dict[str, psutil.Process], start: Any) -> str:
    """Return a finding about the hand, empty without one."""
    for name in processes:
        code = hand.processes[name].returncode
        if code is not None:
            return f"crash: {name} exited with code {code}"
    seen = _next_ticks(hand, processes)
    if not len(seen):
        return f"hang: no tick for {_STILL:g} s of processor time"
    moved = float(np.linalg.norm(seen - start, axis=1).max())
    if moved > _FAR:
        return f"unsafe motion: the object moved by {1e3 * moved:.0f} mm"
    return ""
