# SPDX-License-Identifier: Apache-2.0
"""Message classes by the name of their type."""

from __future__ import annotations

import importlib
import re
from typing import Any

from ament_index_python import get_resource

from tactile_hand_ros.errors import BagError

_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)")


def message_class(type_name: str) -> Any:
    """Return the Python class of a message type.

    The name comes from a bag or from the network, so it imports nothing but packages of interfaces
    that are installed: a module of that name that merely lies on Python's path is not run.

    Args:
        type_name: Full name, e.g. ``sensor_msgs/msg/JointState``.

    Raises:
        BagError: If the type is not installed.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if not match:
        raise BagError(
            f"The message type {type_name[:100]!r} is not a type name, expected package/msg/Type."
        )
    package, name = match.groups()
    try:
        installed, _ = get_resource("rosidl_interfaces", package)
        if not {f"msg/{name}.msg", f"msg/{name}.idl"} & set(installed.split()):
            raise LookupError(name)
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, LookupError, OSError):
        raise BagError(
            f"The message type '{type_name}' is not installed, expected a package with it in "
            "this environment; install or source it to record its topics."
        ) from None
