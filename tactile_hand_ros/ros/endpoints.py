# SPDX-License-Identifier: Apache-2.0
"""Helpers for subscriptions and services: error texts, direct takes, message types by name.

Some subscriptions bypass the executor, because waking it up costs ten times as much as taking a
message. ``take_message``, a method of the object behind the public ``handle``, is not public API.
"""

from __future__ import annotations

import importlib
import re
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ament_index_python import get_resource
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from tactile_hand_ros.errors import BagError, TactileHandError, shortened

_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)")
_ALL = 1_000_000
_PACKAGE = Path(__file__).parents[1]
_GUARD = _PACKAGE / "ros" / "node.py"


class TickFailedError(TactileHandError):
    """A failure of a node at a tick, which the node has already reported."""


def described(error: Exception) -> str:
    """Return an error in one line, with its location in this package."""
    return shortened(f"{type(error).__name__} at {location(error)}: {error}")


def location(error: BaseException) -> str:
    """Return the file and line that raised an error: the innermost of this package, if any."""
    steps = traceback.walk_tb(error.__traceback__)
    places = [(Path(frame.f_code.co_filename), line) for frame, line in steps]
    inside = [each for each in places if each[0].is_relative_to(_PACKAGE) and each[0] != _GUARD]
    if inside:
        file, line = inside[-1]
        return f"{file.relative_to(_PACKAGE)}:{line}"
    return f"{places[-1][0].name}:{places[-1][1]}" if places else "unknown"


def refusal(request: Any, response: Any, reason: str) -> Any:
    """Fill a response with a rejection, if its type has fields for one."""
    no = SetParametersResult(successful=False, reason=reason)
    if hasattr(response, "success"):
        response.success, response.message = False, reason
    elif hasattr(response, "results"):
        response.results = [no for _ in request.parameters]
    elif isinstance(getattr(response, "result", None), SetParametersResult):
        response.result = no
    return response


class DirectTakeGroup(CallbackGroup):
    """A group whose subscriptions no executor serves."""

    def can_execute(self, entity: Any) -> bool:
        """Return False to keep executors from waiting for the entity."""
        return False


def subscribe_directly(
    node: Node, kind: Any, topic: str, profile: QoSProfile | int
) -> Subscription:
    """Subscribe to serialized messages that are read only with `taken` or `take_latest`."""
    # No executor would take an event, so each event would wake it again and again.
    none = SubscriptionEventCallbacks(use_default_callbacks=False)
    group = DirectTakeGroup()
    return node.create_subscription(
        kind, topic, lambda _: None, profile, callback_group=group, event_callbacks=none, raw=True
    )


def taken(subscription: Subscription, limit: int = _ALL) -> Iterator[tuple[Any, Any]]:
    """Yield the waiting messages, oldest first, each with its info from the middleware.

    No executor may serve the subscription. The limit keeps a flood from starving other topics.
    """
    handle, kind, raw = subscription.handle, subscription.msg_type, subscription.raw
    with handle:
        for _ in range(limit):
            item = handle.take_message(kind, raw)
            if item is None:
                return
            yield item


def take_latest(subscription: Subscription) -> Any:
    """Take all waiting messages and return the newest, or None."""
    newest = None
    for newest, _ in taken(subscription):
        pass
    return newest


def message_class(type_name: str) -> Any:
    """Return the Python class of a message type such as ``sensor_msgs/msg/JointState``.

    The name comes from a bag or the network. Only installed interface packages are imported, so it
    cannot run an arbitrary module on the Python path.

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
            f"The message type '{type_name}' is not installed; install or source its package."
        ) from None
