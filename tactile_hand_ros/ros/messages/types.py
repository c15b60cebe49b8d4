# SPDX-License-Identifier: Apache-2.0
"""Message classes by the name of their type."""

from __future__ import annotations

import importlib
from typing import Any

from tactile_hand_ros.errors import BagError


def message_class(type_name: str) -> Any:
    """Return the Python class of a message type.

    Args:
        type_name: Full name, e.g. ``sensor_msgs/msg/JointState``.

    Raises:
        BagError: If the type is not installed.
    """
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError):
        raise BagError(
            f"The message type '{type_name}' is not installed, expected a package with it in "
            "this environment; install or source it to record its topics."
        ) from None
