# SPDX-License-Identifier: Apache-2.0
"""Names of topics, services, frames and nodes, all defined here.

All names except those in `OF_ALL` are relative, so a namespace gives a second hand.
That includes the clock. Without a namespace it is the `/clock` that `use_sim_time` follows. But two
hands in one domain have two times, and with two senders on `/clock` time would jump back and forth.
Remap `clock:=/clock` on one of the plants.

ROS has no message for numbers by finger. So three topics describe contacts as
sensor_msgs/JointState with the finger names in `name` and the tick as timestamp:

- `ground_truth/slip`, from plant to tactile_sensor, recorder and cockpit: `position` is how far the
  contact has slid since the start [m], `velocity` the sliding speed [m/s].
- `grip_state`, from slip_regulator to recorder and cockpit: `position` is the learned friction [1],
  `velocity` the evidence for slip [0 to 1], `effort` the `ContactState`: 0 unknown, 1 stick,
  2 slip.
- `grip_margin`, from slip_regulator to force_optimizer: `position` is the usable friction [1],
  `effort` the reserve for additional load in any direction [N].
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

from tactile_hand_ros.errors import MessageError

JOINT_STATES = "joint_states"
JOINT_COMMAND = "joint_command"
IMU = "imu"
JOINT_HOLD = "joint_hold"
TOUCH_REJECTED = "touch_rejected"
CONTACTS = "tactile/contacts"
GRASP_FORCE = "grasp_force"
GRIP_STATE = "grip_state"
GRIP_MARGIN = "grip_margin"
DESIRED_POSE = "desired_pose"
AUXILIARY_POSE = "auxiliary_pose"
USER_GRASP_FORCE = "user_grasp_force"
ACCEPTED_POSE = "accepted/desired_pose"
ACCEPTED_FORCE = "accepted/user_grasp_force"
USER_COMMANDS = (DESIRED_POSE, USER_GRASP_FORCE)
"""Only the node that acts on a command subscribes to it, so a command with a matched subscriber
reaches the right node. All other nodes use the topics of accepted and rejected commands."""
HAPTIC_FEEDBACK = "haptic_feedback"
PUSH = "push"
OBJECT_POSE = "ground_truth/object_pose"
TRUE_CONTACTS = "ground_truth/contacts"
TRUE_SLIP = "ground_truth/slip"
ROBOT_DESCRIPTION = "robot_description"
DIAGNOSTICS = "/diagnostics"
CLOCK = "clock"
OF_ALL = (DIAGNOSTICS, "/parameter_events", "/rosout")
"""Topics that every node has."""
HIDDEN = "_"
"""First letter of topics that belong to the tools: neither listed nor recorded."""

RESET = "~/reset"
ENABLE = "~/enable"
GRASP = "~/grasp"
RUN = "~/run"
STEP = "~/step"

PALM_FRAME = "palm"

PLANT = "plant"
SENSOR = "tactile_sensor"
REGULATOR = "slip_regulator"
OPTIMIZER = "force_optimizer"
CONTROLLER = "manipulation_controller"
RECORDER = "recorder"
COCKPIT = "cockpit"
COMPOSED = "composed"  # all nodes in one process
RECORD = "--record"  # its argument that adds the recorder
ORCHESTRATOR = "orchestrator"


def wrench(finger: str) -> str:
    """Return the topic of the measured contact force of a finger."""
    return f"tactile/{finger}/wrench"


def optimal_force(finger: str) -> str:
    """Return the topic of a finger's optimal normalized force."""
    return f"optimal_force/{finger}"


def load(finger: str) -> str:
    """Return the topic of the load that a finger carries."""
    return f"load/{finger}"


def true_wrench(finger: str) -> str:
    """Return the topic of the true contact force of a finger."""
    return f"ground_truth/{finger}/wrench"


def accepted_parameters(node: str) -> str:
    """Return the topic of the configurations in force in a node."""
    return f"accepted/{node}/parameters"


def accepted_requests(node: str) -> str:
    """Return the topic of the service calls that changed a node."""
    return f"accepted/{node}/requests"


def rejected(node: str) -> str:
    """Return the topic of the user commands that a node rejected."""
    return f"rejected/{node}"


def ticks_of(node: str) -> str:
    """Return the topic of a node's tick messages in batches, for viewers."""
    return f"{HIDDEN}ticks/{node}"


def contact_frame(finger: str) -> str:
    """Return the name of the contact frame C_i of a finger."""
    return f"{finger}_contact"


def listed(fingers: Iterable[str], chosen: Iterable[object]) -> str:
    """Return the names of the chosen fingers as the text of `TOUCH_REJECTED`."""
    return ", ".join(itertools.compress(fingers, chosen))


def is_listed(fingers: Sequence[str], text: str) -> list[bool]:
    """Return for each finger whether a text of `TOUCH_REJECTED` names it.

    Raises:
        MessageError: If it names anything else.
    """
    chosen = [name for name in text.split(", ") if name]
    if unknown := set(chosen) - set(fingers):
        raise MessageError(
            f"{TOUCH_REJECTED} names {', '.join(sorted(unknown))}, but the fingers are "
            f"{', '.join(fingers)}"
        )
    return [name in chosen for name in fingers]
