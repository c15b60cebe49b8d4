# SPDX-License-Identifier: Apache-2.0
"""Bags as from a recorder, written from the arrays of a record."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter

from support.messages import (
    contacts_message,
    force_message,
    header,
    joint_message,
    pose_message,
    serialized,
    type_name,
)
from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.scenario.scenario import Scenario

START = 1_700_000_000_000_000_000  # log time of the first tick, ns
PERIOD = 3_000_000  # wall time of a tick, ns
ON_TOPICS = (
    *("theta", "rates", "torque", "command", "grasp_force"),
    *("contact_positions", "contact_quaternions", "forces", "optimal_forces"),
    *("auxiliary_position", "auxiliary_quaternion", "desired_position", "desired_quaternion"),
    *("object_position", "object_quaternion"),
    *("true_positions", "true_quaternions", "true_forces"),
    *("true_sliding", "true_slid", "friction", "slip_evidence", "grip"),
)
"""Arrays of a record that a bag contains."""
LATENCY = 1_000_000  # from a tick to its command, ns


class RunWriter(BagWriter):
    """Writes messages by topic in any order; the topic's first message gives its type."""

    def __init__(self, folder: Path, custom_data: dict[str, str] | None = None) -> None:
        super().__init__(folder, custom_data=custom_data or {})
        self.channels: dict[str, int] = {}

    def write(self, topic: str, content: Any, log_time: int) -> None:  # type: ignore[override]
        if topic not in self.channels:
            self.channels[topic] = self.add_channel(topic, type_name(content))
        super().write(self.channels[topic], serialized(content), log_time, log_time)


def parameter_event(stamp: int, node: str, values: dict[str, Any]) -> ParameterEvent:
    """Return the message by which a node publishes its configuration."""
    changed = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    return ParameterEvent(stamp=header(stamp).stamp, node=f"/{node}", changed_parameters=changed)


def request_message(stamp: int, node: str, service: str, value: str = "") -> DiagnosticArray:
    """Return the message by which a node reports that a service call took effect."""
    pair = KeyValue(key=service, value=value)
    status = DiagnosticStatus(name=node, message=service, values=[pair])
    return DiagnosticArray(header=header(stamp, ""), status=[status])


def write_run(bag: RunWriter, scenario: Scenario, record: Record) -> None:
    """Write a scenario's commanded poses as accepted ones, and all ticks of its run."""
    for command in scenario.targets:
        target = command.target()
        pose = pose_message(target.position, target.quaternion, command.stamp)
        bag.write("/accepted/desired_pose", pose, START)
    for row in range(len(record)):
        write_tick(bag, record, row, START + row * PERIOD)


def write_tick(bag: RunWriter, record: Record, row: int, at: int, prefix: str = "/") -> None:
    """Write all messages of one tick, the command later than the others."""
    r, stamp, names = record, int(record.stamps[row]), record.joint_names
    truth = bool(np.isfinite(r.true_forces[row]).any())

    def write(name: str, content: Any) -> None:
        if truth or not name.startswith("ground_truth"):
            bag.write(prefix + name, content, at)

    def write_joints(name: str, joint_names: list[str], *arrays: Any) -> None:
        fields = dict(zip(("position", "velocity", "effort"), arrays, strict=False))
        values = {field: array[row] for field, array in fields.items()}
        write(name, joint_message(joint_names, stamp, **values))

    def write_forces(name: str, forces: Any) -> None:
        for finger, force in zip(r.finger_names, forces[row], strict=True):
            write(name.format(finger), force_message(force, stamp, f"{finger}_contact"))

    write_joints("joint_states", names, r.theta, r.rates, r.torque)
    contacts = r.contact_positions[row], r.contact_quaternions[row]
    write("tactile/contacts", contacts_message(*contacts, stamp))
    true_contacts = r.true_positions[row], r.true_quaternions[row]
    write("ground_truth/contacts", contacts_message(*true_contacts, stamp))
    write_forces("tactile/{}/wrench", r.forces)
    write_forces("ground_truth/{}/wrench", r.true_forces)
    write_forces("optimal_force/{}", r.optimal_forces)
    write("grasp_force", force_message((0.0, r.grasp_force[row], 0.0), stamp))
    write_joints("grip_state", r.finger_names, r.friction, r.slip_evidence, r.grip)
    write_joints("ground_truth/slip", r.finger_names, r.true_slid, r.true_sliding)
    auxiliary = r.auxiliary_position[row], r.auxiliary_quaternion[row]
    write("auxiliary_pose", pose_message(*auxiliary, stamp))
    true = r.object_position[row], r.object_quaternion[row]
    write("ground_truth/object_pose", pose_message(*true, stamp))
    command = joint_message(names, stamp, effort=r.command[row])
    bag.write(f"{prefix}joint_command", command, at + LATENCY)


def write_record(
    folder: Path, record: Record, prefix: str = "/", custom_data: dict[str, str] | None = None
) -> Path:
    """Write a whole record with its first desired pose."""
    with RunWriter(folder, custom_data) as bag:
        known = np.flatnonzero(np.isfinite(record.desired_position[:, 0]))
        if len(known):
            row = known[0]
            pose = record.desired_position[row], record.desired_quaternion[row]
            stamp = int(record.stamps[row])
            bag.write(f"{prefix}accepted/desired_pose", pose_message(*pose, stamp), START)
        for row in range(len(record)):
            write_tick(bag, record, row, START + row * PERIOD, prefix)
    return folder


def random_record(ticks: int = 20, seed: int = 1, truth: bool = True) -> Record:
    """Return a record of a hand with three fingers and nine joints, filled with random numbers."""
    fingers = [f"finger_{i + 1}" for i in range(3)]
    record = Record.empty(ticks, fingers, [f"joint_{i + 1}" for i in range(9)])
    random = np.random.default_rng(seed)
    record.stamps[:] = 2_000_000 * np.arange(ticks)
    for name in ON_TOPICS:
        array = getattr(record, name)
        array[:] = random.normal(size=array.shape)
        if name.endswith(("quaternion", "quaternions")):
            array /= np.linalg.norm(array, axis=-1, keepdims=True)
    # One pose is commanded, before the first tick.
    record.desired_position[:] = record.desired_position[0]
    record.desired_quaternion[:] = record.desired_quaternion[0]
    for name in ON_TOPICS if not truth else ():
        if name.startswith(("object", "true")):
            getattr(record, name)[:] = np.nan
    return record


def assert_same(actual: Record, expected: Record) -> None:
    """Assert that two records are bit-identical, including NaN."""
    for field in fields(Record):
        one, other = getattr(actual, field.name), getattr(expected, field.name)
        if field.metadata:
            np.testing.assert_array_equal(one, other, err_msg=field.name)
        else:
            assert one == other
