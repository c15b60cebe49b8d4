# SPDX-License-Identifier: Apache-2.0
"""Base of all nodes: configuration from parameters, guarded callbacks, diagnostics.

No callback stops a node. A rejected message or request (`TactileHandError`) has no further effect.
Any other exception, and a result that must not be published (`UnsafeOutputError`), is unexpected:
the node reports the line of this package that failed and goes to its safe state.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from tactile_hand_ros import names
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.errors import TactileHandError, UnsafeOutputError, shortened
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.diagnostics import Diagnostics
from tactile_hand_ros.ros.endpoints import TickFailedError, described, refusal
from tactile_hand_ros.ros.parameters import ConfigParameters
from tactile_hand_ros.ros.relay import TickRelay
from tactile_hand_ros.ros.scheduling import report_scheduling

C = TypeVar("C", bound=Config)

DIAGNOSTICS_PERIOD = 1.0
"""Time between two diagnostic messages [s]."""

PEERS_PERIOD = 0.2
"""Period of polling the matched peers [s]; rclpy does not report changes of the graph."""

PUBLICATIONS = "publications"
SUBSCRIPTIONS = "subscriptions"
"""Prefixes of diagnostics keys: followed by a topic, the number of matched peers there."""


class TickPublisher:
    """Publisher that encodes messages only while there is a subscriber or a tap.

    `get_subscription_count` updates the subscribers; the node calls it five times a second. A tap
    is a callback in the publisher's process that receives the same bytes, so a recorder there needs
    no subscription.

    Attributes:
        kind: Message class.
        topic: Full name of the topic.
        taps: They are called with each message before it is sent.
    """

    def __init__(self, node: Node, kind: Any, topic: str, encode: Callable[..., bytes]) -> None:
        """Create the publisher; `encode` serializes the arguments of `publish`."""
        self._encode = encode
        self._publisher = node.create_publisher(kind, topic, qos.PUBLISHED_DEPTH)
        self.kind = kind
        self.topic: str = self._publisher.topic_name
        self.taps: list[Callable[[bytes], None]] = []
        self._is_read = False
        self._last: tuple[Any, ...] | None = None

    def get_subscription_count(self) -> int:
        """Return the current number of matched subscriptions."""
        count = int(self._publisher.get_subscription_count())
        self._is_read = count > 0
        return count

    def publish(self, *values: Any) -> None:
        """Publish a message with these values; encode it only for a subscriber or tap."""
        self._last = values
        if not (self._is_read or self.taps):
            return
        data = self._encode(*values)
        for tap in self.taps:
            tap(data)
        if self._is_read:
            self._publisher.publish(data)

    def repeat(self) -> None:
        """Publish the last message again, also to new subscribers."""
        if self._last is not None:
            self.publish(*self._last)


class TactileNode(Node, Generic[C]):
    """A node whose parameters form one configuration and that survives every callback.

    Exceptions in callbacks of subscriptions, services and timers are counted and reported.

    Publishes `/diagnostics` (diagnostic_msgs/DiagnosticArray) once a second and whenever the number
    of matched peers changes. The ends of a topic may exist before they are matched.

    The constructor of each node raises TactileHandError if a parameter is unknown or rejected, or
    the hand cannot be built.

    Attributes:
        diagnostics: Counters and values to report.
        tick_publishers: Publishers of the node's tick messages.
        fatal: Errors that stop the node.
    """

    fatal: tuple[type[Exception], ...] = ()

    def __init__(self, name: str, model: type[C], **kwargs: Any) -> None:
        """Create the node and declare one parameter per field of the configuration class."""
        self._is_making_safe = False
        super().__init__(name, **kwargs)
        try:
            self._config_parameters = ConfigParameters(
                self, model, self._take_config, self.check_config
            )
        except TactileHandError:
            self.destroy_node()
            raise
        self.diagnostics = Diagnostics(self.get_fully_qualified_name())
        self.tick_publishers: list[TickPublisher] = []
        self._diagnostics_publisher = self.create_publisher(
            DiagnosticArray, names.DIAGNOSTICS, qos.USER_DEPTH
        )
        self.create_timer(DIAGNOSTICS_PERIOD, self.publish_diagnostics)
        self._peers: dict[str, int] = {}
        self.create_timer(PEERS_PERIOD, self._look_for_peers)

    @property
    def config(self) -> C:
        """The configuration in force."""
        return self._config_parameters.config

    def check_config(self, config: C) -> None:
        """Reject a parameter change for reasons that the model alone cannot check.

        Raises:
            TactileHandError: If rejected; its text is the reason shown to the user.
        """

    def on_config(self, config: C) -> None:
        """Apply a changed configuration; override it if parameters are live."""

    def close(self) -> None:
        """Finish work before the node is destroyed, also after a signal; override if needed."""

    def to_safe_state(self, reason: str) -> None:
        """Go to the safe state after an unexpected error; by default, skip the tick."""

    def on_rejected(self, source: str, reason: str) -> None:
        """Handle a rejected message or request of a topic or service; by default, do nothing."""

    def on_repeat(self) -> None:
        """Publish the last answer to a tick again."""
        for publisher in self.tick_publishers:
            publisher.repeat()

    def on_report(self) -> None:
        """Add values to the next diagnostics; override it to report once a second."""

    def _take_config(self, config: C) -> None:
        try:
            self.on_config(config)
        except TactileHandError as error:
            self.diagnostics.fault("configuration", str(error))
            self.get_logger().error(str(error))
        except Exception as error:
            self.survive("configuration", error)
        else:
            self.diagnostics.clear("configuration")

    def guarded(
        self,
        source: str,
        callback: Callable[..., Any],
        refuse: Callable[..., Any] = lambda *_: None,
    ) -> Callable[..., Any]:
        """Return a callback whose errors the node survives and reports by their source.

        After an error its result is that of `refuse` for the same arguments and the reason.
        """

        @functools.wraps(callback)  # rclpy looks at the signature
        def call(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.survive(source, error)
                return refuse(*arguments, described(error))

        return call

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Count and time the answer to a tick.

        Raises:
            TickFailedError: After an error of the node, which has been reported.
        """
        began = time.perf_counter()
        try:
            yield
        except Exception as error:
            self.survive("ticks", error)
            raise TickFailedError(described(error)) from error
        self.diagnostics.tick()
        self.diagnostics.latency(time.perf_counter() - began)

    def tick_publisher(
        self, message_type: Any, topic: str, encode: Callable[..., bytes]
    ) -> TickPublisher:
        """Create a publisher of tick messages."""
        if not self.tick_publishers:
            TickRelay(self, self.tick_publishers)
        self.tick_publishers.append(TickPublisher(self, message_type, topic, encode))
        return self.tick_publishers[-1]

    def subscribe(
        self,
        message_type: Any,
        topic: str,
        callback: Callable[..., None],
        *,
        profile: QoSProfile | int = qos.TICK_DEPTH,
        sensor: bool = False,
        raw: bool = False,
    ) -> Subscription:
        """Subscribe, by default with the quality of service of ticks.

        The callback takes the message, or its bytes if `raw`, and optionally its info from the
        middleware. It may raise TactileHandError to reject the message. With `sensor`, users may
        override history, depth and reliability by parameters such as
        ``qos_overrides.<full topic>.subscription.reliability``.
        """
        options = QoSOverridingOptions.with_default_policies() if sensor else None
        return self.create_subscription(
            message_type, topic, callback, profile, qos_overriding_options=options, raw=raw
        )

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Subscription:
        """Subscribe as rclpy does, with a guarded callback."""
        guarded = self.guarded(topic, callback)
        return super().create_subscription(msg_type, topic, guarded, *args, **kwargs)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], Any], *args: Any, **kwargs: Any
    ) -> Timer:
        """Create a timer with a guarded callback, by default on the steady clock."""
        name = getattr(callback, "__qualname__", type(callback).__name__)
        guarded = self.guarded(f"timer {name}", callback)
        kwargs.setdefault("clock", Clock(clock_type=ClockType.STEADY_TIME))
        return super().create_timer(timer_period_sec, guarded, *args, **kwargs)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **kwargs: Any
    ) -> Service:
        """Create a service as rclpy does, with a guarded callback."""
        guarded = self.guarded(srv_name, callback, refusal)
        return super().create_service(srv_type, srv_name, guarded, **kwargs)

    def reject(self, topic: str, error: TactileHandError | str) -> None:
        """Count a rejected message and log it at a limited rate."""
        self.survive(topic, TactileHandError(error) if isinstance(error, str) else error)

    def survive(self, source: str, error: Exception) -> None:
        """Report an error and continue, in the safe state if the error was unexpected.

        Raises:
            Exception: The error itself if it is `fatal` or the context is shutting down.
        """
        if isinstance(error, self.fatal) or not self.context.ok():
            raise error
        if isinstance(error, TickFailedError):  # `answering` has reported it
            return
        if isinstance(error, TactileHandError) and not isinstance(error, UnsafeOutputError):
            if self.diagnostics.reject(source, error):
                self.get_logger().warning(f"rejected a message on '{source}': {shortened(error)}")
            self.on_rejected(source, shortened(error))
            return
        reason = described(error)
        if self.diagnostics.error(source, reason):
            self.get_logger().error(f"error in '{source}': {reason}")
        self._make_safe(reason)

    def _make_safe(self, reason: str) -> None:
        if self._is_making_safe:  # the safe state itself has failed
            return
        self._is_making_safe = True
        try:
            self.to_safe_state(reason)
        except Exception as error:
            self.survive("safe state", error)
        finally:
            self._is_making_safe = False

    def _look_for_peers(self) -> None:
        """Publish diagnostics immediately when the number of matched peers changes."""
        peers = {**dict.fromkeys(self._peers, 0), **self.peers()}
        if peers != self._peers:
            self._peers = peers
            for key, count in peers.items():
                self.diagnostics.value(key, count)
            self.publish_diagnostics()

    def peers(self) -> dict[str, int]:
        """Return the number of matched peers per topic, by diagnostics key.

        Publishers start sending to the subscribers counted here.
        """
        for publisher in self.tick_publishers:
            publisher.get_subscription_count()
        found = {
            f"{PUBLICATIONS} {each.topic_name}": int(each.get_subscription_count())
            for each in self.publishers
        }
        for each in self.subscriptions:
            found[f"{SUBSCRIPTIONS} {each.topic_name}"] = int(each.get_publisher_count())
        return found

    def publish_diagnostics(self) -> None:
        """Publish the state of the node; called by a timer, or by the node at any time."""
        self.on_report()
        report_scheduling(self.diagnostics)
        self.diagnostics.value("pid", os.getpid())
        message = DiagnosticArray(status=[self.diagnostics.status()])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics_publisher.publish(message)
