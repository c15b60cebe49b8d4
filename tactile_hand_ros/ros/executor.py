# SPDX-License-Identifier: Apache-2.0
"""The nodes' own loop: one wait set, built once, and messages taken directly.

The standard executors of rclpy build a new wait set and a coroutine per callback at every
wake-up, which costs more than the message itself. `WaitSetExecutor` keeps one wait set and calls
subscriptions, timers and guard conditions directly. Everything rare (services, clients, QoS
events, actions, coroutines) is handed to the inherited, public `SingleThreadedExecutor`.

Pieces of rclpy that are not public, all checked by `is_supported`:

* ``rclpy.impl.implementation_singleton.rclpy_implementation.WaitSet``: the wait set itself.
* ``take_message``, ``call_timer`` and ``is_timer_ready`` of the objects behind the public
  ``handle`` of subscriptions and timers.
* ``Subscription._callback_type``: whether a callback wants the message's info too.
* ``Executor._take_service`` and ``_take_subscription``, which `SurvivingExecutor` overrides.
* ``Executor._guard``, ``_sigint_gc``, ``_tasks`` and ``_is_shutdown`` of the base class.

Where one is missing, `make_executor` falls back to `SurvivingExecutor`, which is public rclpy.

What the middleware throws (a request that cannot be taken, an answer that cannot be sent) goes to
``survive`` of the nodes that have it, and does not end the loop.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

from rclpy.context import Context
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
)
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription

from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros.direct.delivery import direct_delivery
from tactile_hand_ros.ros.wait_set import WAIT_LIMIT_NS, WaitedEntities

_BURST = 100
"""Messages taken from one subscription before the others get their turn."""

_TURN = 0.005
"""Time in which nodes of this process answer each other before timers and messages from elsewhere
get their turn [s]."""

_NEEDED = {
    "WaitSet": (
        "add_client add_event add_guard_condition add_service add_subscription add_timer"
        " clear_entities get_ready_entities wait"
    ),
    "Subscription": "take_message pointer",
    "Timer": "call_timer is_timer_ready pointer",
    "GuardCondition": "pointer",
}


def is_supported() -> bool:
    """Return whether this rclpy has every non-public piece that `WaitSetExecutor` uses."""
    native = all(
        hasattr(getattr(_rclpy, name, None), method)
        for name, methods in _NEEDED.items()
        for method in methods.split()
    )
    source = inspect.getsource(Executor.__init__)
    takes = all(hasattr(Executor, name) for name in ("_take_service", "_take_subscription"))
    fields = ("self._guard", "self._sigint_gc", "self._tasks", "self._is_shutdown")
    known = all(field in source for field in fields)
    return native and takes and known and _knows_callback_type()


def _knows_callback_type() -> bool:
    return hasattr(Subscription, "CallbackType") and "_callback_type" in inspect.getsource(
        Subscription
    )


def make_executor(context: Context | None = None) -> Executor:
    """Return the fastest single-threaded executor that this rclpy allows."""
    kind = WaitSetExecutor if is_supported() else SurvivingExecutor
    return kind(context=context)


def spin(nodes: Node | Sequence[Node], executor: Executor | None = None) -> None:
    """Serve one or several nodes of one context until it is shut down.

    Returns normally after SIGINT, SIGTERM or ``rclpy.shutdown``. An exception of a callback ends
    the loop and is passed on.

    Args:
        nodes: The nodes.
        executor: Executor to use; None takes the one of `make_executor`.
    """
    listed = [nodes] if isinstance(nodes, Node) else list(nodes)
    chosen = executor or make_executor(listed[0].context)
    for node in listed:
        chosen.add_node(node)
    try:
        chosen.spin()
    except ExternalShutdownException:
        pass
    finally:
        for node in listed:
            chosen.remove_node(node)
        chosen.shutdown()


class SurvivingExecutor(SingleThreadedExecutor):
    """A single-threaded executor that passes errors to the nodes that survive them.

    A request of damaged bytes makes rclpy raise while it takes it, and would leave the service and
    its callback group locked for ever; hence the two overridden methods that are not public.
    """

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Serve one thing."""
        try:
            super().spin_once(timeout_sec)
        except (ExternalShutdownException, ShutdownException):
            raise
        except Exception as error:
            self._survive("services", error)

    def _take_service(self, srv: Service) -> Any:
        try:
            return super()._take_service(srv)
        except Exception as error:
            owners = [node for node in self.get_nodes() if srv in node.services]
            self._survive(srv.srv_name, _unreadable(error), owners)
            return None

    def _take_subscription(self, sub: Subscription) -> Any:
        try:
            return super()._take_subscription(sub)
        except Exception as error:
            self._refuse(sub, error)
            return None

    def _refuse(self, subscription: Subscription, error: Exception) -> None:
        owners = [node for node in self.get_nodes() if subscription in node.subscriptions]
        self._survive(subscription.topic_name, _unreadable(error), owners)

    def _survive(self, source: str, error: Exception, nodes: Sequence[Node] = ()) -> None:
        """Let the nodes that an error concerns survive it; all where that is not known."""
        survivors = [node for node in nodes or self.get_nodes() if hasattr(node, "survive")]
        if not survivors:
            raise error
        for node in survivors:
            node.survive(source, error)


def _unreadable(error: Exception) -> MessageError:
    return MessageError(f"its bytes cannot be read ({type(error).__name__}).")


class WaitSetExecutor(SurvivingExecutor):
    """A single-threaded executor that keeps its wait set.

    Not for use from several threads, except `create_task`, `wake` and `shutdown`.
    """

    # The base class looks for it at the end, also when a signal cut its construction short.
    _sigint_gc = None

    def __init__(self, *, context: Context | None = None) -> None:
        """Create the executor for a context, by default the global one."""
        self._stale = True
        self._afterwards: list[Callable[[], None]] = []
        super().__init__(context=context)
        self._direct = direct_delivery(self._context)

    def wake(self) -> None:
        """Wait again because an entity was created or destroyed; rclpy calls this."""
        self._stale = True
        super().wake()

    def add_node(self, node: Node) -> bool:
        """Serve a node."""
        self._stale = True
        return bool(super().add_node(node))

    def remove_node(self, node: Node) -> None:
        """Stop serving a node."""
        self._stale = True
        super().remove_node(node)

    def after_reading(self, callback: Callable[[], None]) -> None:
        """Call back once, after the callbacks of all messages that are there now."""
        self._afterwards.append(callback)

    def spin(self) -> None:
        """Execute callbacks until the context or the executor is shut down."""
        if self._direct is not None:
            self._direct.serve(self._guard.trigger)
        while self._is_running():
            self._stale = False
            guards = (self._guard, self._sigint_gc)
            with ExitStack() as stack:
                entities = WaitedEntities(self.get_nodes(), guards, self._context, stack)
                while not self._stale:
                    self._step(entities)

    def _is_running(self) -> bool:
        return bool(self._context.ok()) and not self._is_shutdown

    def _step(self, entities: WaitedEntities) -> None:
        """Wait once and serve what is ready."""
        if self._tasks and self._has_open_tasks():
            # A suspended coroutine may block its callback group; the public executor knows how.
            self.spin_once(timeout_sec=0 if self._direct else WAIT_LIMIT_NS * 1e-9)
            self._deliver()
            self._stale = True
            return
        ready = entities.wait(0 if self._direct else WAIT_LIMIT_NS)
        if ready.guards and not self._is_running():
            self._stale = True
        for guard in ready.guards:
            if guard.callback is not None and not self._stale:
                self._finish(guard.callback())
        for timer in ready.timers:
            # A cancelled timer is reported as ready once more.
            if not self._stale and timer.handle.is_timer_ready():
                timer.handle.call_timer()
                self._finish(timer.callback())
        for subscription in ready.subscriptions:
            self._drain(subscription)
        self._call_afterwards()
        if ready.has_rare and not self._stale:
            self.spin_once(timeout_sec=0)
        self._deliver()

    def _call_afterwards(self) -> None:
        if self._afterwards:
            callbacks, self._afterwards = self._afterwards, []
            for callback in callbacks:
                callback()

    def _deliver(self) -> None:
        """Let the nodes of this process answer each other, in rounds, until all is read."""
        if self._direct is None:
            return
        end = time.monotonic() + _TURN
        while self._direct and not self._stale:
            self._direct.deliver(self._finish)
            self._call_afterwards()
            if time.monotonic() > end:
                break
        self._direct.rest()

    def _has_open_tasks(self) -> bool:
        return any(not task.done() for task, _, _ in self._tasks)

    def _drain(self, subscription: Subscription) -> None:
        take, kind, raw = subscription.handle.take_message, subscription.msg_type, subscription.raw
        wanted = 1 if subscription._callback_type is Subscription.CallbackType.MessageOnly else 2
        for _ in range(_BURST):
            # A subscription that a callback destroyed must not see another message.
            try:
                item = None if self._stale else take(kind, raw)
            except Exception as error:  # bytes that are not this message
                self._refuse(subscription, error)
                continue
            if item is None:
                return
            self._finish(subscription.callback(*item[:wanted]))

    def _finish(self, result: Any) -> None:
        """Let the public executor await what a coroutine function has returned."""
        if result is not None and inspect.iscoroutine(result):
            self.create_task(result)
