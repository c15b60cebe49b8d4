# SPDX-License-Identifier: Apache-2.0
"""Running nodes under hostile messages and requests: bytes on every input and every service."""

from __future__ import annotations

import random
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
from geometry_msgs.msg import PoseArray, PoseStamped, WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

from studies.faults.running_hand import RunningHand
from studies.fuzz.fuzz import Report, chance_of, keep
from studies.fuzz.mutation import damaged
from studies.fuzz.raw_writer import RawWriter, RawWriterError, request_topic
from studies.soak import soak_scenario
from tactile_hand_ros import names
from tactile_hand_ros.ros.processes import end_together
from tactile_hand_ros.scenario.scenario import NODES

_RATE = 250.0
_BURST = 20  # inputs between two looks at the hand
_STILL = 2.0  # s of work without a tick that count as a hang
_FAR = 0.05  # m that the object may move under attack at rest
_PAUSE = 0.02  # s between two bursts

_ROOM = 1000  # bytes that a damaged message may have behind its header


class _Input(NamedTuple):
    """A good message.

    Attributes:
        topic: Topic of the middleware.
        kind: Its type.
        data: The message.
        room: Bytes that it may have behind its header when it is damaged.
    """

    topic: str
    kind: Any
    data: bytes
    room: int = _ROOM


def _inputs(hand: RunningHand) -> list[_Input]:
    """Return every input of the nodes: topics, and requests of services."""
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
    found = [_Input(f"rt/{t}", k, bytes(serialize_message(k()))) for t, k in topics.items()]
    value = ParameterValue(type=3, double_value=1.0)
    parameters = [Parameter(name="law.k_p", value=value)]
    requests: dict[str, tuple[Any, Any]] = {
        "set_parameters": (SetParameters, SetParameters.Request(parameters=parameters)),
        "set_parameters_atomically": (
            SetParametersAtomically,
            SetParametersAtomically.Request(parameters=parameters),
        ),
        "get_parameters": (GetParameters, GetParameters.Request(names=["hand"])),
    }
    for node in NODES:
        for name, (kind, request) in requests.items():
            data = bytes(serialize_message(request))
            found.append(_Input(request_topic(f"/{node}/{name}"), kind.Request, data))
    for service, kind in (("reset", Trigger), ("enable", SetBool), ("grasp", SetBool)):
        topic = request_topic(f"/{names.CONTROLLER}/{service}")
        # Too short for a call that acts: a hand that is asked to let go does so.
        found.append(_Input(topic, kind.Request, b"\0\1\0\0", room=0))
    return found


def fuzz_nodes(report: Report, seconds: float, folder: Path) -> None:
    """Attack running nodes for a time, and add to a report what became of them.

    The bytes of a message are damaged behind its header, so that it is of a type that the nodes
    read. Values that are plausible are not sent here: see `make study NAME=faults`.

    Args:
        report: What is added to.
        seconds: How long.
        folder: Where the last burst before a finding is kept.
    """
    scenario = soak_scenario(_RATE, lockstep=True).changed({"targets": []})
    with (
        tempfile.TemporaryDirectory() as scratch,
        RunningHand(scenario, Path(scratch), "", composed=False) as hand,
    ):
        hand.begin()
        hand.wait_for_time(0.3)
        _attack(hand, report, seconds, folder)
        # Nodes may still have requests to refuse that announce gigabytes; do not wait for that.
        end_together(list(hand.processes.values()), is_urgent=lambda: True)


def _attack(hand: RunningHand, report: Report, seconds: float, folder: Path) -> None:
    inputs = _inputs(hand)
    writers = [RawWriter(hand.node, each.kind, each.topic) for each in inputs]
    processes = {name: psutil.Process(p.pid) for name, p in hand.processes.items()}
    memory = {name: process.memory_info().rss for name, process in processes.items()}
    begin, number = time.monotonic(), 0
    start = hand.positions(hand.events)[1][-1]
    while time.monotonic() - begin < seconds:
        sent = []
        for number in range(number, number + _BURST):
            chance = chance_of(report.seed, "live", number)
            which = chance.randrange(len(inputs))
            data = _damaged_behind_header(inputs[which], chance)
            with suppress(RawWriterError):  # more bytes than the type can have are not sent
                writers[which].write(data)
            sent.append(f"{inputs[which].topic} {data.hex()}")
        number += 1
        report.inputs["live"] += _BURST
        _wait(hand)
        if what := _wrong(hand, processes, start):
            keep(report, folder, "live", number, "\n".join(sent).encode(), what)
            break
        if what := _grown(report, processes, memory):
            keep(report, folder, "live", number, "\n".join(sent).encode(), what)
    for writer in writers:
        writer.close()


def _grown(report: Report, processes: dict[str, psutil.Process], memory: dict[str, int]) -> str:
    """Note the largest growth; return which node has just grown by more than it may, or nothing."""
    had_grown = report.grew
    for name, process in processes.items():
        grown = process.memory_info().rss - memory[name]
        if grown > report.growth:
            report.growth, report.grew_most = grown, name
    if had_grown or not report.grew:
        return ""
    return f"growth: {report.grew_most} by {report.growth / 2**20:.0f} MB"


def _damaged_behind_header(given: _Input, chance: random.Random) -> bytes:
    return given.data[:4] + damaged(given.data[4:], chance)[: given.room]


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
