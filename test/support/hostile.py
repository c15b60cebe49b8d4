# SPDX-License-Identifier: Apache-2.0
"""The message readers that tests attack with hostile bytes, and the number of attempts."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from hypothesis import HealthCheck, settings
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from tactile_hand_ros.ros.messages import (
    ContactsCodec,
    JointCodec,
    PoseCodec,
    PushCodec,
    WrenchCodec,
    read_number,
)

_FINGERS = ["finger_1", "finger_2", "finger_3"]
_CHECKS = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
_SHORT = settings(derandomize=True, database=None, max_examples=50)


def hostile(examples: int = 50) -> settings:
    """Return how many inputs are tried; `--hypothesis-profile fuzz` tries many random ones."""
    is_short = settings.default.max_examples <= 100
    base = settings(_SHORT, max_examples=examples) if is_short else settings.default
    return settings(base, deadline=None, suppress_health_check=_CHECKS)


class Reader(NamedTuple):
    """A reader of the bytes of a message.

    Attributes:
        decode: Returns timestamp, ns, and content; raises `MessageError` to reject the bytes.
        good: Valid bytes.
    """

    decode: Callable[[bytes], tuple[int, Any]]
    good: bytes


def message_readers() -> dict[str, Reader]:
    """Return a reader for each kind of message that the nodes read."""
    three, turns = np.array([0.5, -1.0, 2.0]), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    nan = np.full(3, np.nan)
    joints = JointCodec(_FINGERS, ("position", "velocity", "effort"))
    efforts, contacts = JointCodec(_FINGERS, ("effort",)), ContactsCodec(3)
    force, slip, grip = (
        WrenchCodec("tip"),
        JointCodec(_FINGERS, ("position", "velocity")),
        JointCodec(_FINGERS),
    )
    optimal, any_frame = WrenchCodec("tip", nan_allowed=True), WrenchCodec("palm", any_frame=True)
    untouched = contacts.encode(np.eye(3) * np.nan, turns * np.nan, 7)
    return {
        "joints": Reader(joints.decode, joints.encode(7, three, three, three)),
        "efforts": Reader(efforts.decode, efforts.encode(7, three)),
        "contacts": Reader(contacts.decode, contacts.encode(np.eye(3), turns, 7)),
        "no contacts": Reader(contacts.decode, untouched),
        "force": Reader(force.decode, force.encode(three, 7)),
        "no force": Reader(optimal.decode, optimal.encode(nan, 7)),
        "force in any frame": Reader(any_frame.decode, force.encode(three, 7)),
        "slip": Reader(slip.decode, slip.encode(7, three, three)),
        "grip": Reader(grip.decode, grip.encode(7, three, three, three)),
        "pose": Reader(PoseCodec().decode, PoseCodec().encode(three, turns[0], 7)),
        "push": Reader(PushCodec().decode, PushCodec().encode(np.arange(6.0), 7)),
        "number": Reader(_read_number, bytes(serialize_message(Float64(data=3.0)))),
    }


def _read_number(data: bytes) -> tuple[int, Any]:
    return 0, read_number(data)
