# SPDX-License-Identifier: Apache-2.0
"""Topic names and quality of service: the wiring between the nodes.

All names except `DIAGNOSTICS` are relative, so a namespace gives a second hand. That includes the
clock: without a namespace it is the `/clock` that `use_sim_time` follows, but two hands in one
domain have two times, and two senders on `/clock` would make time jump to and fro for everybody.
Remap `clock:=/clock` on the one plant whose time shall rule.

Two topics describe contacts as sensor_msgs/JointState with the names of the fingers in `name` and
the tick as stamp, since ROS has no message for numbers by finger:

- `ground_truth/slip`, from the plant to tactile_sensor and recorder: `position` is the distance
  that the contact has slid since the start [m], `velocity` the sliding speed [m/s].
- `grip_state`, from slip_regulator to force_optimizer and recorder: `position` is the learned
  friction [1], `velocity` the evidence for slip [0 to 1], `effort` the `Grip`: 0 unknown, 1 stick,
  2 slip.
"""

from __future__ import annotations

from rclpy.qos import (
    QoSDurabilityPolicy,
    QoSHistoryPolicy,
    QoSProfile,
    QoSReliabilityPolicy,
)

JOINT_STATES = "joint_states"
JOINT_COMMAND = "joint_command"
CONTACTS = "tactile/contacts"
GRASP_FORCE = "grasp_force"
GRIP_STATE = "grip_state"
DESIRED_POSE = "desired_pose"
AUXILIARY_POSE = "auxiliary_pose"
USER_GRASP_FORCE = "user_grasp_force"
HAPTIC_FEEDBACK = "haptic_feedback"
OBJECT_POSE = "ground_truth/object_pose"
TRUE_CONTACTS = "ground_truth/contacts"
TRUE_SLIP = "ground_truth/slip"
ROBOT_DESCRIPTION = "robot_description"
DIAGNOSTICS = "/diagnostics"
CLOCK = "clock"
TF = "/tf"

RESET = "~/reset"
ENABLE = "~/enable"
GRASP = "~/grasp"
RUN = "~/run"

PALM_FRAME = "palm"
OBJECT_FRAME = "object"

TICK_DEPTH = 100
"""Messages kept per tick topic: 0.2 s at 500 Hz, more than any consumer may lag behind."""

PUBLISHED_DEPTH = 3000
"""Messages that a publisher keeps of a tick topic: 6 s at 500 Hz, for a recorder that fell behind.
In lockstep everybody waits for everybody else, but nobody waits for the recorder."""


def wrench(finger: str) -> str:
    """Return the topic of the measured contact force of a finger."""
    return f"tactile/{finger}/wrench"


def optimal_force(finger: str) -> str:
    """Return the topic of the optimal normalised force of a finger."""
    return f"optimal_force/{finger}"


def true_wrench(finger: str) -> str:
    """Return the topic of the true contact force of a finger."""
    return f"ground_truth/{finger}/wrench"


def contact_frame(finger: str) -> str:
    """Return the name of the contact frame C_i of a finger."""
    return f"{finger}_contact"


def tick_qos() -> QoSProfile:
    """Return the profile of everything that carries a tick: reliable, deep, volatile.

    A new object each time, because rclpy writes QoS overrides into the profile it is given.
    """
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=TICK_DEPTH,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.VOLATILE,
    )


def tick_publisher_qos() -> QoSProfile:
    """Return the profile with which ticks are published: as `tick_qos`, with a longer memory."""
    profile = tick_qos()
    profile.depth = PUBLISHED_DEPTH
    return profile


def latched_qos() -> QoSProfile:
    """Return the profile of values that late subscribers must get: transient local, depth 1."""
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
    )


def user_qos() -> QoSProfile:
    """Return the profile of what a user or tool sends and watches: reliable, depth 100."""
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=100,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.VOLATILE,
    )
