# SPDX-License-Identifier: Apache-2.0
"""The streams of messages that form a tick, each declared once with its topic and codec."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PoseArray, WrenchStamped
from sensor_msgs.msg import Imu, JointState

from tactile_hand_ros import names
from tactile_hand_ros.ros.messages import ContactsCodec, ImuCodec, JointCodec, WrenchCodec

Decode = Callable[[bytes], tuple[int, Any]]
"""Function from the bytes of a message to its tick [ns] and value; raises MessageError."""


@dataclass(frozen=True)
class Stream:
    """One input of a node: topics of one type, each with its decoder.

    Attributes:
        per_finger: Whether the values of the topics form one array, with a row per finger.
        from_driver: Whether a driver may publish it, so that users may override its QoS.
    """

    message_type: type
    decoders: dict[str, Decode]
    per_finger: bool = False
    from_driver: bool = False


def joints(joint_names: Sequence[str]) -> Stream:
    """Declare the joint states; values are `Joints`. Joints of an arm are ignored."""
    codec = JointCodec(joint_names, others=True)
    return Stream(JointState, {names.JOINT_STATES: codec.decode_joints}, from_driver=True)


def imu() -> Stream:
    """Declare the palm's orientation in the world; values are quaternions (x, y, z, w)."""
    return Stream(Imu, {names.IMU: ImuCodec().decode}, from_driver=True)


def contacts(fingers: int) -> Stream:
    """Declare the measured contacts; values are `Contacts` in the palm frame."""
    decode = ContactsCodec(fingers).decode_contacts
    return Stream(PoseArray, {names.CONTACTS: decode}, from_driver=True)


def forces(finger_names: Sequence[str]) -> Stream:
    """Declare the measured forces; in contact frames, (k, 3), N, NaN where a skin has no axis."""
    return _wrenches(names.wrench, finger_names, normal_allowed=True, from_driver=True)


def optimal_forces(finger_names: Sequence[str]) -> Stream:
    """Declare f*; values in contact frames, shape (k, 3), N, NaN where (13) has no solution."""
    return _wrenches(names.optimal_force, finger_names, nan_allowed=True)


def grasp_force() -> Stream:
    """Declare the grasp force k_f; values in N."""
    codec = WrenchCodec(names.PALM_FRAME, any_frame=True)
    return Stream(WrenchStamped, {names.GRASP_FORCE: codec.decode_normal})


def loads(finger_names: Sequence[str]) -> Stream:
    """Declare the loads of the fingers; in contact frames, (k, 3), N, NaN without a grasp."""
    return _wrenches(names.load, finger_names, nan_allowed=True)


def grip_margin(finger_names: Sequence[str]) -> Stream:
    """Declare usable friction and reserve; values are two arrays of shape (k,), 1 and N."""
    decode = JointCodec(finger_names, ("position", "effort")).decode
    return Stream(JointState, {names.GRIP_MARGIN: decode})


def true_contacts(fingers: int) -> Stream:
    """Declare the contacts of the simulation; values are one `Pose` in the palm frame."""
    return Stream(PoseArray, {names.TRUE_CONTACTS: ContactsCodec(fingers).decode})


def true_sliding(finger_names: Sequence[str]) -> Stream:
    """Declare distance slid and sliding speed; values are two arrays of shape (k,), m and m/s."""
    decode = JointCodec(finger_names, ("position", "velocity")).decode
    return Stream(JointState, {names.TRUE_SLIP: decode})


def true_forces(finger_names: Sequence[str]) -> Stream:
    """Declare the forces of the simulation; values in contact frames, shape (k, 3), N."""
    return _wrenches(names.true_wrench, finger_names)


def _wrenches(
    topic: Callable[[str], str],
    finger_names: Sequence[str],
    *,
    from_driver: bool = False,
    **allowed: bool,
) -> Stream:
    decoders: dict[str, Decode] = {
        topic(name): WrenchCodec(names.contact_frame(name), **allowed).decode
        for name in finger_names
    }
    return Stream(WrenchStamped, decoders, True, from_driver)
