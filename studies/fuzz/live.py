# SPDX-License-Identifier: Apache-2.0
"""Running nodes under hostile messages: damaged bytes on every input."""

from __future__ import annotations

import tempfile
import time
from contextlib import suppress
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
from studies.fuzz.fuzz import Report, chance_of, keep
from studies.fuzz.mutation import damaged
from studies.soak import soak_scenario
from tactile_hand_ros import names
from tactile_hand_ros.ros import qos

_RATE = 250.0
_BURST = 20  # inputs between two looks at the hand
_STILL = 2.0  # s of work without a tick that count as a hang
_FAR = 0.05  # m that the object may move under attack at rest
_PAUSE = 0.02  # s between two bursts
_ROOM = 1000  # bytes that a damaged message may have behind its header


def _inputs(hand: RunningHand) -> dict[str, Any]:
    """Return every topic that a node reads, with its type."""
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


def fuzz_nodes(report: Report, seconds: float, folder: Path) -> None:
    """Attack running nodes for a time, and add to a report what became of them.

    The bytes of a message are damaged behind its header, so that it is of a type that the nodes
    read. Values that are plausible are not sent here: see `make study NAME=faults`. Nor are
    requests of services: the middleware trusts their lengths, see docs/security.md.

    Args:
        report: What is added to.
        seconds: How long.
        folder: Where the last burst before a finding is kept.
    """
    scenario = soak_scenario(_RATE, lockstep=True).changed({"targets": []})
    with (
        tempfile.TemporaryDirectory() as scratch,
        RunningHand(scenario, Path(scratch), composed=False) as hand,
    ):
        hand.begin()
        hand.wait_for_time(0.3)
        _attack(hand, report, seconds, folder)


def _attack(hand: RunningHand, report: Report, seconds: float, folder: Path) -> None:
    inputs = _inputs(hand)
    topics = list(inputs)
    good = {topic: bytes(serialize_message(kind())) for topic, kind in inputs.items()}
    publishers = {
        topic: hand.node.create_publisher(kind, topic, qos.user_qos())
        for topic, kind in inputs.items()
    }
    processes = {name: psutil.Process(p.pid) for name, p in hand.processes.items()}
    memory = {name: process.memory_info().rss for name, process in processes.items()}
    begin, start = time.monotonic(), hand.positions(hand.events)[1][-1]
    while time.monotonic() - begin < seconds:
        sent = []
        for number in range(report.inputs["live"], report.inputs["live"] + _BURST):
            chance = chance_of(report.seed, "live", number)
            topic = chance.choice(topics)
            data = good[topic][:4] + damaged(good[topic][4:], chance)[:_ROOM]
            with suppress(_rclpy.RCLError):  # longer than any message of a bounded type
                publishers[topic].publish(data)
                sent.append(f"{topic} {data.hex()}")
        report.inputs["live"] += _BURST
        _wait(hand)
        for name, process in processes.items():
            grown = process.memory_info().rss - memory[name]
            if grown > report.growth:
                report.growth, report.grew_most = grown, name
        if what := _wrong(hand, processes, start):
            keep(report, folder, "live", number, "\n".join(sent).encode(), what)
            break


def _wait(hand: RunningHand) -> None:
    until = time.monotonic() + _PAUSE
    hand.wait(lambda: time.monotonic() > until, "the next burst")
    hand.forget_but(5000)


def _next_ticks(hand: RunningHand, processes: dict[str, psutil.Process]) -> Any:
    """Return where the object was seen just now; nothing if a node is too busy to answer.

    A machine that is busy with something else is no hang: what counts is the time that a node works
    without a tick, or a silence of ten times that.
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
    """Return what is wrong with the hand; empty while all is well."""
    for name in processes:
        code = hand.processes[name].returncode
        if code is not None:
            return f"death: {name} ended with code {code}"
    seen = _next_ticks(hand, processes)
    if not len(seen):
        return f"hang: no tick for {_STILL:g} s of processor time"
    moved = float(np.linalg.norm(seen - start, axis=1).max())
    if moved > _FAR:
        return f"unsafe motion: the object has moved by {1e3 * moved:.0f} mm"
    return ""
