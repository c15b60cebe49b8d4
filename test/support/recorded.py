# SPDX-License-Identifier: Apache-2.0
"""Bags as from a recorder, written from the arrays of a record."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from tactile_hand_ros.bag.writer import BagWriter
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.scenario.scenario import Scenario

STORE = get_typestore(Stores.ROS2_JAZZY)
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


def message(type_name: str, **values: Any) -> Any:
    return STORE.types[type_name](**values)


def header(stamp: int, frame: str = "palm") -> Any:
    time = message("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    return message("std_msgs/msg/Header", stamp=time, frame_id=frame)


def vector(values: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def pose(position: Any, quaternion: Any) -> Any:
    x, y, z, w = map(float, quaternion)
    return message(
        "geometry_msgs/msg/Pose",
        position=message("geometry_msgs/msg/Point", **vector(position)),
        orientation=message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )


def pose_stamped(stamp: int, position: Any, quaternion: Any, frame: str = "palm") -> Any:
    return message(
        "geometry_msgs/msg/PoseStamped",
        header=header(stamp, frame),
        pose=pose(position, quaternion),
    )


def pose_array(stamp: int, positions: Any, quaternions: Any) -> Any:
    poses = [pose(*pair) for pair in zip(positions, quaternions, strict=True)]
    return message("geometry_msgs/msg/PoseArray", header=header(stamp), poses=poses)


def wrench(stamp: int, force: Any, frame: str = "palm") -> Any:
    zero = message("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    force = message("geometry_msgs/msg/Vector3", **vector(force))
    body = message("geometry_msgs/msg/Wrench", force=force, torque=zero)
    return message("geometry_msgs/msg/WrenchStamped", header=header(stamp, frame), wrench=body)


def joints(stamp: int, names: list[str], **values: Any) -> Any:
    fields = {"position": [], "velocity": [], "effort": []} | values
    arrays = {name: np.asarray(field, dtype=np.float64) for name, field in fields.items()}
    return message("sensor_msgs/msg/JointState", header=header(stamp, ""), name=names, **arrays)


class RunWriter:
    """Writes messages by topic in any order; the topic's first message gives its type."""

    def __init__(self, folder: Path, custom_data: dict[str, str] | None = None) -> None:
        self.bag = BagWriter(folder, custom_data=custom_data or {})
        self.channels: dict[str, int] = {}

    def write(self, topic: str, content: Any, log_time: int) -> None:
        type_name = content.__msgtype__
        if topic not in self.channels:
            self.channels[topic] = self.bag.add_channel(topic, type_name)
        data = bytes(STORE.serialize_cdr(content, type_name))
        self.bag.write(self.channels[topic], data, log_time, log_time)

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.bag.close()


def parameter_event(stamp: int, node: str, values: dict[str, Any]) -> Any:
    """Return the message by which a node publishes its configuration."""
    defaults: dict[str, Any] = {"type": 0, "bool_value": False, "integer_value": 0}
    defaults |= {"double_value": 0.0, "string_value": "", "string_array_value": []}
    for kind, dtype in (("byte", "u1"), ("bool", "?"), ("integer", "i8"), ("double", "f8")):
        defaults[f"{kind}_array_value"] = np.array([], dtype=dtype)
    changed = []
    for name, value in values.items():
        kind, field, given = _parameter_value(value)
        content = message(
            "rcl_interfaces/msg/ParameterValue", **{**defaults, "type": kind, field: given}
        )
        changed.append(message("rcl_interfaces/msg/Parameter", name=name, value=content))
    return message(
        "rcl_interfaces/msg/ParameterEvent",
        stamp=header(stamp).stamp,
        node=f"/{node}",
        new_parameters=[],
        changed_parameters=changed,
        deleted_parameters=[],
    )


def _parameter_value(value: Any) -> tuple[int, str, Any]:
    """Return the type of a parameter, the field of its value and its content."""
    if isinstance(value, list | tuple):
        return 8, "double_array_value", np.array(value, dtype=np.float64)
    kinds = {bool: (1, "bool_value"), int: (2, "integer_value"), float: (3, "double_value")}
    return (*kinds.get(type(value), (4, "string_value")), value)


def request_message(stamp: int, node: str, service: str, value: str = "") -> Any:
    """Return the message by which a node reports that a service call took effect."""
    pair = message("diagnostic_msgs/msg/KeyValue", key=service, value=value)
    status = message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=0,
        name=node,
        message=service,
        hardware_id="",
        values=[pair],
    )
    return message("diagnostic_msgs/msg/DiagnosticArray", header=header(stamp, ""), status=[status])


def write_run(bag: RunWriter, scenario: Scenario, record: Record) -> None:
    """Write a scenario's commanded poses as accepted ones, and all ticks of its run."""
    for command in scenario.targets:
        target = command.target()
        pose = pose_stamped(command.stamp, target.position, target.quaternion)
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
        write(name, joints(stamp, joint_names, **values))

    def write_forces(name: str, forces: Any) -> None:
        for finger, force in zip(r.finger_names, forces[row], strict=True):
            write(name.format(finger), wrench(stamp, force, f"{finger}_contact"))

    write_joints("joint_states", names, r.theta, r.rates, r.torque)
    contacts = r.contact_positions[row], r.contact_quaternions[row]
    write("tactile/contacts", pose_array(stamp, *contacts))
    true_contacts = r.true_positions[row], r.true_quaternions[row]
    write("ground_truth/contacts", pose_array(stamp, *true_contacts))
    write_forces("tactile/{}/wrench", r.forces)
    write_forces("ground_truth/{}/wrench", r.true_forces)
    write_forces("optimal_force/{}", r.optimal_forces)
    write("grasp_force", wrench(stamp, (0.0, r.grasp_force[row], 0.0)))
    write_joints("grip_state", r.finger_names, r.friction, r.slip_evidence, r.grip)
    write_joints("ground_truth/slip", r.finger_names, r.true_slid, r.true_sliding)
    auxiliary = r.auxiliary_position[row], r.auxiliary_quaternion[row]
    write("auxiliary_pose", pose_stamped(stamp, *auxiliary))
    true = r.object_position[row], r.object_quaternion[row]
    write("ground_truth/object_pose", pose_stamped(stamp, *true))
    command = joints(stamp, names, effort=r.command[row])
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
            bag.write(f"{prefix}accepted/desired_pose", pose_stamped(stamp, *pose), START)
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
