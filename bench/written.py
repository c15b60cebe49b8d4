# SPDX-License-Identifier: Apache-2.0
"""The in-process loop that writes the bag of a run: an upper bound for composed nodes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.cdr import clock_bytes
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
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
        writer.check()
        began = time.perf_counter()
        for row in range(ticks):
            loop.tick(record, row)
            for topic, kind, data in messages.of(row):
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
        self._record = record
        fingers, joints = record.finger_names, record.joint_names
        self._states = JointCodec(joints, ("position", "velocity", "effort"))
        self._command = JointCodec(joints, ("effort",))
        self._slip, self._grips = JointCodec(fingers, ("position", "velocity")), JointCodec(fingers)
        self._contacts, self._pose = ContactsCodec(len(fingers)), PoseCodec()
        self._grasp_force = WrenchCodec(names.PALM_FRAME)
        self._forces = [
            WrenchCodec(names.contact_frame(name), normal_allowed=True) for name in fingers
        ]
        self._optimal = [
            WrenchCodec(names.contact_frame(name), nan_allowed=True) for name in fingers
        ]

    def of(self, row: int) -> Iterator[Message]:
        """Yield the messages of a tick."""
        yield from self._of_plant(row)
        yield from self._of_controllers(row)

    def _of_plant(self, row: int) -> Iterator[Message]:
        r, stamp = self._record, int(self._record.stamps[row])
        slip = self._slip.encode(stamp, r.true_slid[row], r.true_sliding[row])
        yield names.TRUE_SLIP, _JOINTS, slip
        contacts = self._contacts.encode(r.true_positions[row], r.true_quaternions[row], stamp)
        yield names.TRUE_CONTACTS, _CONTACTS, contacts
        yield from self._wrenches(names.true_wrench, self._forces, r.true_forces, row)
        states = self._states.encode(stamp, r.theta[row], r.rates[row], r.torque[row])
        yield names.JOINT_STATES, _JOINTS, states
        pose = self._pose.encode(r.object_position[row], r.object_quaternion[row], stamp)
        yield names.OBJECT_POSE, _POSE, pose
        yield names.CLOCK, _CLOCK, clock_bytes(stamp)

    def _of_controllers(self, row: int) -> Iterator[Message]:
        r, stamp = self._record, int(self._record.stamps[row])
        contacts = self._contacts.encode(
            r.contact_positions[row], r.contact_quaternions[row], stamp
        )
        yield names.CONTACTS, _CONTACTS, contacts
        yield from self._wrenches(names.wrench, self._forces, r.forces, row)
        grips = self._grips.encode(stamp, r.friction[row], r.slip_evidence[row], r.grip[row])
        yield names.GRIP_STATE, _JOINTS, grips
        grasp_force = self._grasp_force.encode((0.0, float(r.grasp_force[row]), 0.0), stamp)
        yield names.GRASP_FORCE, _WRENCH, grasp_force
        yield from self._wrenches(names.optimal_force, self._optimal, r.optimal_forces, row)
        yield names.JOINT_COMMAND, _JOINTS, self._command.encode(stamp, r.command[row])
        position = r.auxiliary_position[row]
        if np.isfinite(position[0]):
            pose = self._pose.encode(position, r.auxiliary_quaternion[row], stamp)
            yield names.AUXILIARY_POSE, _POSE, pose

    def _wrenches(
        self,
        topic: Callable[[str], str],
        codecs: Sequence[WrenchCodec],
        forces: NDArray[np.float64],
        row: int,
    ) -> Iterator[Message]:
        """Yield the forces of one tick by finger; `forces` has shape (n, k, 3)."""
        stamp = int(self._record.stamps[row])
        of_tick = zip(self._record.finger_names, codecs, forces[row].tolist(), strict=True)
        for name, codec, force in of_tick:
            yield topic(name), _WRENCH, codec.encode(force, stamp)
