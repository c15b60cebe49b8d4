# SPDX-License-Identifier: Apache-2.0
"""The in-process loop that writes the bag of a run: an upper bound for composed nodes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from tactile_hand_ros import names
from tactile_hand_ros.cdr import clock_bytes
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.loads import CarriedLoad
from tactile_hand_ros.nodes.recorder.writer_process import WriterProcess
from tactile_hand_ros.ros.messages import ContactsCodec, JointCodec, PoseCodec, WrenchCodec
from tactile_hand_ros.scenario.scenario import Scenario

_JOINTS = "sensor_msgs/msg/JointState"
_CONTACTS = "geometry_msgs/msg/PoseArray"
_WRENCH = "geometry_msgs/msg/WrenchStamped"
_POSE = "geometry_msgs/msg/PoseStamped"
_CLOCK = "rosgraph_msgs/msg/Clock"

Message = tuple[str, str, bytes]
"""Topic, type and bytes."""


def written_calls(scenario: Scenario, ticks: int) -> float:
    """Return the ticks per second of computing in-process, encoding and writing.

    The writer is that of a recorder in the same process as the nodes.
    """
    loop = ClosedLoop(scenario)
    hand = loop.plant.hand
    record = Record.empty(ticks, hand.finger_names, hand.joint_names)
    messages = TickMessages(record)
    channels: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        writer = WriterProcess(Path(folder) / "bag", compression="zstd")
        began = time.perf_counter()
        for row in range(ticks):
            loop.tick(record, row)
            carried = messages.carried(row, loop.regulator.carried)
            for topic, kind, data in (*messages.of(row), *carried):
                if topic not in channels:
                    channels[topic] = writer.add_channel(topic, kind)
                now = time.time_ns()
                writer.write(channels[topic], data, now, now)
            writer.send()
        passed = time.perf_counter() - began
        writer.close()
    return ticks / passed


class TickMessages:
    """Encodes the ticks of a record as the nodes do."""

    def __init__(self, record: Record) -> None:
        """Create the codecs for a record, which may be filled tick by tick."""
        r, fingers, joints = record, record.finger_names, record.joint_names
        self._record = r
        contacts, pose = ContactsCodec(len(fingers)).encode, PoseCodec().encode
        slip, command = (
            JointCodec(fingers, ("position", "velocity")),
            JointCodec(joints, ("effort",)),
        )
        wrench = WrenchCodec(names.PALM_FRAME).encode
        self._parts = [
            _joints(names.TRUE_SLIP, slip, r.true_slid, r.true_sliding),
            _pose(names.TRUE_CONTACTS, _CONTACTS, contacts, r.true_positions, r.true_quaternions),
            *_wrenches(names.true_wrench, fingers, r.true_forces),
            _joints(names.JOINT_STATES, JointCodec(joints), r.theta, r.rates, r.torque),
            _pose(names.OBJECT_POSE, _POSE, pose, r.object_position, r.object_quaternion),
            (names.CLOCK, _CLOCK, lambda stamp, _: clock_bytes(stamp)),
            _pose(names.CONTACTS, _CONTACTS, contacts, r.contact_positions, r.contact_quaternions),
            *_wrenches(names.wrench, fingers, r.forces),
            _joints(names.GRIP_STATE, JointCodec(fingers), r.friction, r.slip_evidence, r.grip),
            (names.GRASP_FORCE, _WRENCH, lambda t, i: wrench((0.0, r.grasp_force[i], 0.0), t)),
            *_wrenches(names.optimal_force, fingers, r.optimal_forces),
            _joints(names.JOINT_COMMAND, command, r.command),
        ]
        self._auxiliary = _pose(
            names.AUXILIARY_POSE, _POSE, pose, r.auxiliary_position, r.auxiliary_quaternion
        )
        self._loads = [(names.load(name), _wrench_codec(name)) for name in fingers]
        self._margin = JointCodec(fingers, ("position", "effort"))

    def of(self, row: int) -> Iterator[Message]:
        """Yield the messages of a tick that a record has."""
        stamp, is_posed = int(self._record.stamps[row]), self._record.auxiliary_position[row, 0]
        for topic, kind, encode in self._parts + [self._auxiliary] * bool(np.isfinite(is_posed)):
            yield topic, kind, encode(stamp, row)

    def carried(self, row: int, carried: CarriedLoad) -> Iterator[Message]:
        """Yield the messages of a tick that only the regulator has."""
        stamp = int(self._record.stamps[row])
        for (topic, codec), load in zip(self._loads, carried.load.tolist(), strict=True):
            yield topic, _WRENCH, codec.encode(load, stamp)
        margin = self._margin.encode(stamp, carried.friction, carried.reserve)
        yield names.GRIP_MARGIN, _JOINTS, margin


Part = tuple[str, str, Callable[[int, int], bytes]]
"""Topic, type, and a function of timestamp [ns] and row."""


def _joints(topic: str, codec: JointCodec, *arrays: Array) -> Part:
    return topic, _JOINTS, lambda stamp, row: codec.encode(stamp, *(each[row] for each in arrays))


def _pose(
    topic: str, kind: str, encode: Callable[..., bytes], positions: Array, quaternions: Array
) -> Part:
    return topic, kind, lambda stamp, row: encode(positions[row], quaternions[row], stamp)


def _wrenches(topic: Callable[[str], str], fingers: Sequence[str], forces: Array) -> list[Part]:
    """Return the forces by finger."""
    return [_wrench(topic(name), name, forces[:, i]) for i, name in enumerate(fingers)]


def _wrench_codec(finger: str) -> WrenchCodec:
    return WrenchCodec(names.contact_frame(finger), nan_allowed=True)


def _wrench(topic: str, finger: str, forces: Array) -> Part:
    codec = _wrench_codec(finger)
    return topic, _WRENCH, lambda stamp, row: codec.encode(forces[row].tolist(), stamp)
