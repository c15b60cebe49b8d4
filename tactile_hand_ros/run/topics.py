# SPDX-License-Identifier: Apache-2.0
"""Which topics of a bag belong to one hand, and how they are called."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tactile_hand_ros import names
from tactile_hand_ros.errors import BagError

_OF_FINGER = (names.wrench, names.optimal_force, names.true_wrench)
_TYPES = {
    names.JOINT_STATES: "sensor_msgs/msg/JointState",
    names.JOINT_COMMAND: "sensor_msgs/msg/JointState",
    names.CONTACTS: "geometry_msgs/msg/PoseArray",
    names.GRASP_FORCE: "geometry_msgs/msg/WrenchStamped",
    names.GRIP_STATE: "sensor_msgs/msg/JointState",
    names.ACCEPTED_POSE: "geometry_msgs/msg/PoseStamped",
    names.ACCEPTED_FORCE: "geometry_msgs/msg/WrenchStamped",
    names.AUXILIARY_POSE: "geometry_msgs/msg/PoseStamped",
    names.OBJECT_POSE: "geometry_msgs/msg/PoseStamped",
    names.TRUE_CONTACTS: "geometry_msgs/msg/PoseArray",
    names.TRUE_SLIP: "sensor_msgs/msg/JointState",
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
                found[self.full(pattern(finger))] = "geometry_msgs/msg/WrenchStamped"
        return found

    def check(self, types: Mapping[str, str]) -> None:
        """Insist that the topics have the types of the contract.

        Args:
            types: Types in the bag by full topic name.

        Raises:
            BagError: If one has another type, or there are commands without the ticks at which they
                took effect.
        """
        for topic, expected in self.types.items():
            if types.get(topic, expected) != expected:
                raise BagError(
                    f"The topic {topic} has the type {types[topic]}, expected {expected}; remap it "
                    "or record the right one."
                )
        sent, accepted = self.full(names.DESIRED_POSE), self.full(names.ACCEPTED_POSE)
        if sent in types and accepted not in types:
            raise BagError(
                f"The bag has {sent} but not {accepted}, which says when each pose took effect; "
                "record it again with this version, and with that topic."
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
    known = sorted(
        t.removesuffix(names.JOINT_STATES) for t in topics if t.endswith("/" + names.JOINT_STATES)
    )
    hands = ", ".join(prefix.strip("/") or "/" for prefix in known)
    if not known:
        raise BagError(
            f"The bag {bag} has no topic {names.JOINT_STATES}, without which there are no ticks; "
            "record it along with the others."
        )
    if namespace is None:
        if len(known) > 1:
            raise BagError(f"The bag {bag} holds several hands; choose a namespace: {hands}.")
        return known[0]
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    if prefix not in known:
        raise BagError(f"The bag {bag} has no hand in the namespace '{namespace}', only: {hands}.")
    return prefix


def find_fingers(topics: Iterable[str], prefix: str) -> list[str]:
    """Return the fingers named in topics, in natural order (finger_2 before finger_10)."""
    patterns = [re.escape(prefix) + p("([^/]+)") for p in _OF_FINGER]
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
