# SPDX-License-Identifier: Apache-2.0
"""How a node receives and sends: guarded callbacks, messages taken directly, publishers of ticks.

No callback stops a node. A message or request that is rejected (`TactileHandError`) costs only
itself. Anything else, and a result that must not be published (`UnsafeOutputError`), was not
foreseen: it is reported with the line of this package that failed, and the node goes to its safe
state.

Some subscriptions are read without an executor, which would wake up for each message at ten times
the cost of taking it. ``take_message`` of the object behind the public ``handle`` is not public.
"""

from __future__ import annotations

import functools
import importlib
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from ament_index_python import get_resource
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from tactile_hand_ros.errors import BagError, TactileHandError, UnsafeOutputError, shortened
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import Diagnostics

_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)")
_ALL = 1_000_000
_THIS = Path(__file__)
_PACKAGE = _THIS.parents[1]


class Guarded(Protocol):
    """A node, as the guard sees it."""

    diagnostics: Diagnostics
    fatal: tuple[type[Exception], ...]
    context: Any

    def get_logger(self) -> Any:
        """Return the node's logger."""

    def to_safe_state(self, reason: str) -> None:
        """Do what is safe after an error that was not foreseen."""

    def on_rejected(self, source: str, reason: str) -> None:
        """Do what is to be done about a message that was rejected."""


class TickFailedError(TactileHandError):
    """A node has failed at a tick, and has reported why."""


class CallbackGuard:
    """Runs the callbacks of one node."""

    def __init__(self, node: Guarded) -> None:
        """Guard a node; it may still be under construction."""
        self._node = node
        self._is_making_safe = False

    def wrap(self, source: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a callback that never raises while the node is running.

        Args:
            source: Topic, service or timer that is named when the callback fails.
            callback: The callback, a plain function.
        """

        @functools.wraps(callback)  # rclpy looks at the signature
        def guarded(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.caught(source, error)
                return None

        return guarded

    def wrap_service(self, source: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a service callback that answers a rejection where the given one raises."""

        @functools.wraps(callback)
        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                self.caught(source, error)
                return refusal(request, response, described(error))

        return guarded

    def caught(self, source: str, error: Exception) -> None:
        """Count and report what a callback threw, and make the node safe if it was not foreseen.

        Raises:
            Exception: The error itself if it stops this node, or if the context is being shut down.
        """
        node = self._node
        if isinstance(error, node.fatal) or not node.context.ok():
            raise error
        if isinstance(error, TactileHandError) and not isinstance(error, UnsafeOutputError):
            if node.diagnostics.reject(source, error):
                node.get_logger().warning(f"rejected a message on '{source}': {shortened(error)}")
            node.on_rejected(source, shortened(error))
            return
        reason = described(error)
        if node.diagnostics.error(source, reason):
            node.get_logger().error(f"error in '{source}': {reason}")
        self._make_safe(reason)

    def _make_safe(self, reason: str) -> None:
        if self._is_making_safe:  # the safe state itself has failed
            return
        self._is_making_safe = True
        try:
            self._node.to_safe_state(reason)
        except Exception as error:
            self.caught("safe state", error)
        finally:
            self._is_making_safe = False


class Answering:
    """Counts and times the answers to ticks, for use in `with`.

    An error inside is the node's own: it is reported, and stops the tick with `TickFailedError`.
    """

    def __init__(self, guard: CallbackGuard, diagnostics: Diagnostics) -> None:
        """Take what reports."""
        self._guard, self._diagnostics = guard, diagnostics
        self._began = 0.0

    def __enter__(self) -> None:
        """Start an answer."""
        self._began = time.perf_counter()

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        """Count the answer, or report why there is none."""
        if error is None:
            self._diagnostics.tick()
            self._diagnostics.latency(time.perf_counter() - self._began)
        elif isinstance(error, Exception):
            self._guard.caught("ticks", error)
            raise TickFailedError(shortened(error)) from error


def described(error: Exception) -> str:
    """Return an error in one line: what, and where in this package."""
    return shortened(f"{type(error).__name__} at {location(error)}: {error}")


def location(error: BaseException) -> str:
    """Return file and line in which an error arose: the innermost of this package, if any."""
    inner, is_inside, trace = "unknown", False, error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        is_ours = file.is_relative_to(_PACKAGE) and file != _THIS
        if is_ours or not is_inside:
            name = file.relative_to(_PACKAGE) if is_ours else file.name
            inner, is_inside = f"{name}:{trace.tb_lineno}", is_ours
        trace = trace.tb_next
    return inner


def refusal(request: Any, response: Any, reason: str) -> Any:
    """Fill a response with a rejection, as far as its type has fields for it."""
    no = SetParametersResult(successful=False, reason=reason)
    if hasattr(response, "success"):
        response.success, response.message = False, reason
    elif hasattr(response, "results"):
        response.results = [no for _ in request.parameters]
    elif isinstance(getattr(response, "result", None), SetParametersResult):
        response.result = no
    return response


class DirectTakeGroup(CallbackGroup):
    """Keeps its subscriptions out of every executor."""

    def can_execute(self, entity: Any) -> bool:
        """Return False, so that no executor waits for the entity."""
        return False


def _ignore(_: bytes) -> None:
    """Stand in for a callback."""


def subscribe_directly(
    node: Node,
    kind: Any,
    topic: str,
    profile: QoSProfile,
    **options: Any,
) -> Subscription:
    """Subscribe to serialized messages that are only taken with `taken` or `take_latest`.

    Args:
        node: Owner of the subscription.
        kind: Message class.
        topic: Name of the topic.
        profile: Quality of service.
        **options: For `rclpy.node.Node.create_subscription`.
    """
    group = DirectTakeGroup()
    # No executor would take an event, and each would wake for it again and again.
    options.setdefault("event_callbacks", SubscriptionEventCallbacks(use_default_callbacks=False))
    return node.create_subscription(
        kind, topic, _ignore, profile, callback_group=group, raw=True, **options
    )


def taken(subscription: Subscription, limit: int = _ALL) -> Iterator[tuple[Any, Any]]:
    """Take the waiting messages, oldest first; bytes where the subscription is raw.

    Args:
        subscription: Which no executor serves at the same time.
        limit: Maximum number of messages: a flood must not starve other topics.

    Yields:
        A message and what the middleware reports about it.
    """
    handle, kind, raw = subscription.handle, subscription.msg_type, subscription.raw
    with handle:
        for _ in range(limit):
            item = handle.take_message(kind, raw)
            if item is None:
                return
            yield item


def take_latest(subscription: Subscription) -> Any:
    """Take everything that has arrived and return the newest message, None if there is none."""
    newest = None
    for newest, _ in taken(subscription):
        pass
    return newest


class TickPublisher:
    """Encodes and publishes messages while there is a subscriber or a tap.

    Subscribers are those at the last call of `get_subscription_count`; the node looks five times a
    second.

    A tap is called in the publisher's process with the same bytes, so a recorder there needs no
    subscription.

    Attributes:
        node: The node that publishes.
        kind: Message class.
        topic: Full name of the topic.
        qos_profile: Quality of service that it offers.
    """

    def __init__(self, node: Node, kind: Any, topic: str) -> None:
        """Create the publisher.

        Args:
            node: The node that publishes.
            kind: Message class.
            topic: Relative name of the topic.
        """
        self._publisher = node.create_publisher(kind, topic, qos.tick_publisher_qos())
        self.node, self.kind = node, kind
        self.topic: str = self._publisher.topic_name
        self.qos_profile: QoSProfile = self._publisher.qos_profile
        self._taps: list[Callable[[bytes], None]] = []
        self._is_read = False
        self._last: tuple[Callable[..., bytes], tuple[Any, ...]] | None = None

    def add_tap(self, tap: Callable[[bytes], None]) -> None:
        """Call back with each message from now on, before it is sent."""
        self._taps.append(tap)

    @property
    def wanted(self) -> bool:
        """Whether there is a tap or, at the last look, a subscriber."""
        return self._is_read or bool(self._taps)

    def get_subscription_count(self) -> int:
        """Return the number of matching subscriptions now."""
        count = int(self._publisher.get_subscription_count())
        self._is_read = count > 0
        return count

    def publish(self, encode: Callable[..., bytes], *values: Any) -> None:
        """Publish what `encode(*values)` returns; it is not called without a subscriber or tap."""
        self._last = encode, values
        if self.wanted:
            self._send(encode(*values))

    def repeat(self) -> None:
        """Publish the last message again, also to those that came after it."""
        if self._last is not None:
            encode, values = self._last
            self.publish(encode, *values)

    def _send(self, data: bytes) -> None:
        for tap in self._taps:
            tap(data)
        if self._is_read:
            self._publisher.publish(data)


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
