# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag belong to one hand, and how they are called.

Bags are analysed on machines without ROS too, so the names are written down here again; a test
compares them with those of the nodes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tactile_hand_ros.errors import BagError

JOINT_STATES = "joint_states"
JOINT_COMMAND = "joint_command"
CONTACTS = "tactile/contacts"
GRASP_FORCE = "grasp_force"
GRIP_STATE = "grip_state"
DESIRED_POSE = "desired_pose"
AUXILIARY_POSE = "auxiliary_pose"
OBJECT_POSE = "ground_truth/object_pose"
TRUE_CONTACTS = "ground_truth/contacts"
TRUE_SLIP = "ground_truth/slip"
WRENCH = "tactile/{}/wrench"
OPTIMAL_FORCE = "optimal_force/{}"
TRUE_WRENCH = "ground_truth/{}/wrench"
DIAGNOSTICS = "/diagnostics"
PALM_FRAME = "palm"

_OF_FINGER = (WRENCH, OPTIMAL_FORCE, TRUE_WRENCH)
_TYPES = {
    JOINT_STATES: "sensor_msgs/msg/JointState",
    JOINT_COMMAND: "sensor_msgs/msg/JointState",
    CONTACTS: "geometry_msgs/msg/PoseArray",
    GRASP_FORCE: "geometry_msgs/msg/WrenchStamped",
    GRIP_STATE: "sensor_msgs/msg/JointState",
    DESIRED_POSE: "geometry_msgs/msg/PoseStamped",
    AUXILIARY_POSE: "geometry_msgs/msg/PoseStamped",
    OBJECT_POSE: "geometry_msgs/msg/PoseStamped",
    TRUE_CONTACTS: "geometry_msgs/msg/PoseArray",
    TRUE_SLIP: "sensor_msgs/msg/JointState",
}


@dataclass(frozen=True)
class HandTopics:
    """The topics of one hand in a bag.

    Attributes:
        prefix: What stands before the relative names, ``/`` or ``/left/``.
        fingers: Names of the fingers in the order of all arrays.
    """

    prefix: str
    fingers: list[str]

    def full(self, name: str) -> str:
        """Return the full name of a relative topic."""
        return self.prefix + name

    @property
    def types(self) -> dict[str, str]:
        """Type of each topic by its full name."""
        found = {self.full(name): type_name for name, type_name in _TYPES.items()}
        for pattern in _OF_FINGER:
            for finger in self.fingers:
                found[self.full(pattern.format(finger))] = "geometry_msgs/msg/WrenchStamped"
        return found

    def check(self, types: Mapping[str, str]) -> None:
        """Insist that the topics have the types of the contract.

        Args:
            types: Types in the bag by full topic name.

        Raises:
            BagError: If one has another type.
        """
        for topic, expected in self.types.items():
            if types.get(topic, expected) != expected:
                raise BagError(
                    f"The topic {topic} has the type {types[topic]}, expected {expected}; remap it "
                    "or record the right one."
                )


def find_prefix(topics: Iterable[str], namespace: str | None, bag: object) -> str:
    """Return what stands before the relative names of a hand's topics.

    Args:
        topics: Full names of all topics in the bag.
        namespace: The hand's namespace; None if there is only one hand.
        bag: Name of the bag, for the error text.

    Raises:
        BagError: If there is no such hand, or more than one to choose from.
    """
    known = sorted(t.removesuffix(JOINT_STATES) for t in topics if t.endswith("/" + JOINT_STATES))
    names = ", ".join(prefix.strip("/") or "/" for prefix in known)
    if not known:
        raise BagError(
            f"The bag {bag} has no topic {JOINT_STATES}, without which there are no ticks; record "
            "it along with the others."
        )
    if namespace is None:
        if len(known) > 1:
            raise BagError(f"The bag {bag} holds several hands; choose a namespace: {names}.")
        return known[0]
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    if prefix not in known:
        raise BagError(f"The bag {bag} has no hand in the namespace '{namespace}', only: {names}.")
    return prefix


def find_fingers(topics: Iterable[str], prefix: str) -> list[str]:
    """Return the fingers that topics tell of, in natural order (finger_2 before finger_10)."""
    patterns = [re.escape(prefix) + p.format("([^/]+)") for p in _OF_FINGER]
    found = {
        match.group(1)
        for topic in topics
        for pattern in patterns
        if (match := re.fullmatch(pattern, topic))
    }
    return sorted(found, key=_natural)


def _natural(name: str) -> list[tuple[int, str]]:
    parts = re.findall(r"\d+|\D+", name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
