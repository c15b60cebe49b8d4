# SPDX-License-Identifier: Apache-2.0
"""Origin of a bag: the scenario and the versions of the software."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

import tactile_hand_ros

SCENARIO_KEY = "scenario"
"""Key of the scenario's YAML text in the bag's custom data."""

LOST_KEY = "lost_messages"
"""Key of the number of lost messages in the custom data; followed by a topic, the number there."""

# Libraries that can change a result; `pin` is Pinocchio's name on PyPI.
_LIBRARIES = ("rclpy", "numpy", "osqp", "pin")


def versions() -> dict[str, str]:
    """Return the versions of package, Python, ROS distribution and numerical libraries by name."""
    found = {
        "tactile_hand_ros": tactile_hand_ros.__version__,
        "python": platform.python_version(),
        "ros_distro": os.environ.get("ROS_DISTRO") or "jazzy",
    }
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # installed without Python metadata
            continue
    return found


def provenance(scenario: str) -> dict[str, str]:
    """Return the origin of a bag as texts, from the resolved scenario as YAML, empty if none."""
    found = {SCENARIO_KEY: scenario} if scenario else {}
    return found | {f"version_{name}": text for name, text in versions().items()}
