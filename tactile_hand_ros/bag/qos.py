# SPDX-License-Identifier: Apache-2.0
"""Quality of service as rosbag2 writes it down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tactile_hand_ros.bag.yaml_text import dump

INFINITE = 2**63 - 1  # ns, what the middleware reports for "no limit"


@dataclass(frozen=True)
class OfferedQos:
    """What one publisher offers; durations in ns, policies by the names of rmw."""

    history: str = "unknown"
    depth: int = 0
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline: int = INFINITE
    lifespan: int = INFINITE
    liveliness: str = "automatic"
    liveliness_lease_duration: int = INFINITE
    avoid_ros_namespace_conventions: bool = False

    @classmethod
    def from_profile(cls, profile: Any) -> OfferedQos:
        """Read an ``rclpy.qos.QoSProfile``, as the graph reports it."""
        return cls(
            history=profile.history.name.lower(),
            depth=profile.depth,
            reliability=profile.reliability.name.lower(),
            durability=profile.durability.name.lower(),
            deadline=profile.deadline.nanoseconds,
            lifespan=profile.lifespan.nanoseconds,
            liveliness=profile.liveliness.name.lower(),
            liveliness_lease_duration=profile.liveliness_lease_duration.nanoseconds,
            avoid_ros_namespace_conventions=profile.avoid_ros_namespace_conventions,
        )

    def as_tree(self) -> dict[str, Any]:
        """Return the mapping that metadata version 9 holds."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _duration(self.deadline),
            "lifespan": _duration(self.lifespan),
            "liveliness": self.liveliness,
            "liveliness_lease_duration": _duration(self.liveliness_lease_duration),
            "avoid_ros_namespace_conventions": self.avoid_ros_namespace_conventions,
        }


def qos_text(offers: Sequence[OfferedQos]) -> str:
    """Return the text of a channel's ``offered_qos_profiles``."""
    return dump([offer.as_tree() for offer in offers])


def _duration(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(nanoseconds, 10**9)
    return {"sec": seconds, "nsec": rest}
