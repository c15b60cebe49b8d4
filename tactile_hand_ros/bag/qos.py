# SPDX-License-Identifier: Apache-2.0
"""Quality of service as rosbag2 writes it down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from tactile_hand_ros.bag.yaml_text import dump, load

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


def parse_qos(text: str) -> tuple[OfferedQos, ...]:
    """Read a channel's ``offered_qos_profiles``; empty where there are none that can be read.

    Bags of older versions name the policies by the numbers of rmw.
    """
    try:
        profiles = load(text) if text.strip() else []
        return tuple(_offer(profile) for profile in profiles)
    except (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        return ()


_POLICIES = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": ("system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown"),
}


def _offer(profile: dict[str, Any]) -> OfferedQos:
    policies: dict[str, Any] = {
        name: names[value] if isinstance(value := profile[name], int) else str(value)
        for name, names in _POLICIES.items()
    }
    times: dict[str, Any] = {
        name: int(profile[name]["sec"]) * 10**9 + int(profile[name]["nsec"])
        for name in ("deadline", "lifespan", "liveliness_lease_duration")
    }
    plain = bool(profile.get("avoid_ros_namespace_conventions", False))
    return OfferedQos(
        depth=int(profile["depth"]), avoid_ros_namespace_conventions=plain, **policies, **times
    )
