# SPDX-License-Identifier: Apache-2.0
"""The message readers that tests attack with hostile bytes, and the number of attempts."""

from collections.abc import Callable
from typing import Any

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


Reader = tuple[Callable[[bytes], tuple[int, Any]], bytes]
"""Returns timestamp [ns] and content of a message, or raises `MessageError`; and valid bytes."""


def message_readers() -> dict[str, Reader]:
    """Return a reader for each kind of message that the nodes read."""
    three, turns = np.array([0.5, -1.0, 2.0]), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    nan = np.full(3, np.nan)
    joints = JointCodec(_FINGERS, ("position", "velocity", "effort"))
    efforts, contacts = JointCodec(_FINGERS, ("effort",)), ContactsCodec(3)
    slip, grip = JointCodec(_FINGERS, ("position", "velocity")), JointCodec(_FINGERS)
    force, number = WrenchCodec("tip"), serialize_message(Float64(data=3.0))
    optimal, any_frame = WrenchCodec("tip", nan_allowed=True), WrenchCodec("palm", any_frame=True)
    untouched = contacts.encode(np.eye(3) * np.nan, turns * np.nan, 7)
    return {
        "joints": (joints.decode, joints.encode(7, three, three, three)),
        "efforts": (efforts.decode, efforts.encode(7, three)),
        "contacts": (contacts.decode, contacts.encode(np.eye(3), turns, 7)),
        "no contacts": (contacts.decode, untouched),
        "force": (force.decode, force.encode(three, 7)),
        "no force": (optimal.decode, optimal.encode(nan, 7)),
        "force in any frame": (any_frame.decode, force.encode(three, 7)),
        "slip": (slip.decode, slip.encode(7, three, three)),
        "grip": (grip.decode, grip.encode(7, three, three, three)),
        "pose": (PoseCodec().decode, PoseCodec().encode(three, turns[0], 7)),
        "push": (PushCodec().decode, PushCodec().encode(np.arange(6.0), 7)),
        "number": (lambda data: (0, read_number(data)), bytes(number)),
    }
