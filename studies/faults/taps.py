# SPDX-License-Identifier: Apache-2.0
"""Which topics pass the fault node, and what it does to the bytes of their messages."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseArray, WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from tactile_hand_ros import names

PREFIX = "tapped/"
"""Where the publisher of a tapped topic sends it instead."""

_HEADER, _STAMP = 4, 12  # bytes at which the stamp of a message begins and ends
_RIGID = 3.0  # by how much a wrong value is wrong: factor of a force
_AWAY = 0.02  # m
_TURN = 0.2  # rad


def tapped(tap: str, fingers: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Return the topics of a tap, with the node that publishes each and its type."""
    if tap == "joints":
        return {
            names.JOINT_STATES: (names.PLANT, JointState),
            names.JOINT_COMMAND: (names.CONTROLLER, JointState),
        }
    if tap == "touch":
        forces = {names.wrench(name): (names.SENSOR, WrenchStamped) for name in fingers}
        return {names.CONTACTS: (names.SENSOR, PoseArray), **forces}
    if tap == "forces":
        shapes = {names.optimal_force(name): (names.OPTIMIZER, WrenchStamped) for name in fingers}
        return {names.GRASP_FORCE: (names.REGULATOR, WrenchStamped), **shapes}
    return {}


def topics_of(component: str, fingers: Sequence[str]) -> list[str]:
    """Return the topics that fail when a component does."""
    skin = [names.CONTACTS, *map(names.wrench, fingers)]
    return {
        "joint link": [names.JOINT_STATES],
        "controller": [names.JOINT_COMMAND],
        "skin of one finger": [names.wrench(fingers[0])],
        "skin of all fingers": skin,
        "sensor": skin,
        "regulator": [names.GRASP_FORCE],
        "optimizer": [names.optimal_force(name) for name in fingers],
    }.get(component, [])


def stuck(data: bytes, frozen: bytes) -> bytes:
    """Return a message of old values with the stamp of a new one."""
    return frozen[:_HEADER] + data[_HEADER:_STAMP] + frozen[_STAMP:]


def garbage(data: bytes, chance: random.Random) -> bytes:
    """Return random bytes behind the stamp, as many as there were."""
    return data[:_STAMP] + chance.randbytes(len(data) - _STAMP)


def stepped(data: bytes) -> bytes:
    """Return a message whose clock is an hour ahead."""
    (seconds,) = struct.unpack_from("<i", data, _HEADER)
    return data[:_HEADER] + struct.pack("<i", seconds + 3600) + data[_HEADER + 4 :]


def wrong(data: bytes, kind: Any) -> bytes:
    """Return a message of plausible values that are not true."""
    message = deserialize_message(data, kind)
    _WRONG[kind](message)
    return bytes(serialize_message(message))


def _wrong_joints(message: Any) -> None:
    message.position = [value + _TURN for value in message.position]
    message.effort = [-value for value in message.effort]


def _wrong_force(message: Any) -> None:
    force = message.wrench.force
    force.x, force.y, force.z = -_RIGID * force.x, _RIGID * force.y, -_RIGID * force.z


def _wrong_contacts(message: Any) -> None:
    for pose in message.poses:
        pose.position.x += _AWAY


_WRONG: dict[Any, Callable[[Any], None]] = {
    JointState: _wrong_joints,
    WrenchStamped: _wrong_force,
    PoseArray: _wrong_contacts,
}
