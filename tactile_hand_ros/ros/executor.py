# SPDX-License-Identifier: Apache-2.0
"""Executor of the nodes: it builds its wait sets once and takes messages directly.

At every wake-up, the standard executors of rclpy build a new wait set and a coroutine per callback.
That costs more than handling the message. `WaitSetExecutor` keeps its wait set and calls
subscriptions, timers and guard conditions directly. Services and clients have a second wait set,
checked every `RARE_PERIOD_NS`. The inherited, public `SingleThreadedExecutor` serves them, and the
QoS events of each node every `EVENT_PERIOD_NS`. Callbacks are plain functions: coroutines are not
awaited.

Private parts of rclpy (Jazzy) in use:

* ``rclpy.impl.implementation_singleton.rclpy_implementation.WaitSet``: the wait set itself.
* ``take_message``, ``call_timer`` and ``is_timer_ready`` of the objects behind the public
  ``handle`` of subscriptions and timers.
* ``Subscription._callback_type``: whether a callback also takes the message info.
* ``Executor._take_service``, ``_guard``, ``_sigint_gc`` and ``_is_shutdown`` of the base class.

A node with work to do between messages has a method `work`, which returns whether there is more to
do. The executor calls it repeatedly and does not block meanwhile.

A middleware error (an unreadable request, an unsendable reply) is passed to the node's ``survive``
if it has one, and does not stop the loop.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from tactile_hand_ros.errors import MessageError

_BURST = 100
"""Maximum number of messages taken from one subscription before the others are served."""

RARE_PERIOD_NS = 50_000_000
"""Maximum wait of a service request [ns]."""

EVENT_PERIOD_NS = 1_000_000_000
"""Maximum wait of a QoS event [ns]; checking one node costs 0.3 ms."""

_KINDS = ("subscription", "guard_condition", "timer", "client", "service")


def spin(nodes: Node | Sequence[Node], executor: Executor | None = None) -> None:
    """Serve one or several nodes of one context until it is shut down.

    Returns after SIGINT, SIGTERM or ``rclpy.shutdown``. An exception in a callback propagates. The
    default executor is a new `WaitSetExecutor`.
    """
    listed = [nodes] if isinstance(nodes, Node) else list(nodes)
    chosen = executor or WaitSetExecutor(context=listed[0].context)
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


class _WaitSet:
    """A native wait set and its entities, which it keeps alive."""

    def __init__(
        self, entities: Mapping[str, Iterable[Any]], context: Context, stack: ExitStack
    ) -> None:
        """Collect the entities, by kind; `stack` keeps their handles in use until it closes."""
        self._known: dict[int, Any] = {}
        held: list[tuple[str, Any]] = []
        stack.enter_context(context.handle)
        for kind, each in ((kind, each) for kind, some in entities.items() for each in some):
            with suppress(InvalidHandle):  # destroyed by another thread in the meantime
                stack.enter_context(each.handle)
                self._known[each.handle.pointer] = each
                held.append((kind, each.handle))
        count = Counter(kind for kind, _ in held)
        self._native = _rclpy.WaitSet(*(count[kind] for kind in _KINDS), 0, context.handle)
        stack.enter_context(self._native)
        self._adding = [(getattr(self._native, f"add_{kind}"), handle) for kind, handle in held]

    def wait(self, limit_ns: int) -> None:
        """Wait until an entity is ready, or until the limit [ns]."""
        self._native.clear_entities()  # a wait removes entities that are not ready
        for add, handle in self._adding:
            add(handle)
        self._native.wait(limit_ns)

    def ready(self, kind: str) -> list[Any]:
        """Return the entities of a kind that the last wait found ready."""
        return [self._known[at] for at in self._native.get_ready_entities(kind)]


class WaitSetExecutor(SingleThreadedExecutor):
    """A single-threaded executor that keeps its wait set.

    Not for use from several threads, except `wake` and `shutdown`.
    """

    # The base class reads it at shutdown, even if a signal interrupted its construction.
    _sigint_gc = None

    def __init__(self, *, context: Context | None = None) -> None:
        """Create the executor for a context, by default the global one."""
        self._stale = True
        self._spins = False
        self._rare_due = self._events_due = self._turn = 0
        self._afterwards: list[Callable[[], None]] = []
        super().__init__(context=context)

    def wake(self) -> None:
        """Rebuild the wait sets; rclpy calls this when an entity is created or destroyed."""
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
        """Call back once, after all waiting messages have been handled."""
        self._afterwards.append(callback)

    def can_execute(self, entity: Any) -> bool:
        """Return whether the public executor serves an entity: during `spin`, only rare ones."""
        is_frequent = isinstance(entity, Subscription | Timer | GuardCondition)
        return not (self._spins and is_frequent) and bool(super().can_execute(entity))

    def spin(self) -> None:
        """Execute callbacks until the context or the executor is shut down."""
        while self._is_running():
            with ExitStack() as stack:
                frequent, rare = self._wait_sets(stack)
                works = [node.work for node in self.get_nodes() if hasattr(node, "work")]
                is_busy = bool(works)
                while not self._stale:
                    self._step(frequent, 0 if is_busy else RARE_PERIOD_NS)
                    self._look_for_rare(rare)
                    is_busy = any([work() for work in works])

    def _wait_sets(self, stack: ExitStack) -> tuple[_WaitSet, _WaitSet]:
        """Return the wait sets of directly called entities and of services and clients."""
        self._stale, self._spins = False, False
        nodes = self.get_nodes()
        guards = [self._guard, self._sigint_gc, *(g for node in nodes for g in node.guards)]
        own = [s for node in nodes for s in node.subscriptions if self.can_execute(s)]
        timers = [timer for node in nodes for timer in node.timers]
        self._spins = True
        frequent = {"subscription": own, "timer": timers, "guard_condition": guards}
        rare = {
            "client": [client for node in nodes for client in node.clients],
            "service": [service for node in nodes for service in node.services],
        }
        return _WaitSet(frequent, self._context, stack), _WaitSet(rare, self._context, stack)

    def _step(self, waiting: _WaitSet, limit_ns: int) -> None:
        """Wait once, up to a limit [ns], and serve every entity that is ready."""
        waiting.wait(limit_ns)
        guards = waiting.ready("guard_condition")
        if guards and not self._is_running():
            self._stale = True
        for guard in guards:
            if guard.callback is not None and not self._stale:
                guard.callback()
        for timer in waiting.ready("timer"):
            # A cancelled timer is reported as ready one more time.
            if not self._stale and timer.handle.is_timer_ready():
                timer.handle.call_timer()
                timer.callback()
        for subscription in waiting.ready("subscription"):
            self._drain(subscription)
        self._call_afterwards()

    def _look_for_rare(self, rare: _WaitSet) -> None:
        """Serve services and clients, and the QoS events of one node per turn, when due."""
        now = time.monotonic_ns()
        if now < self._rare_due or self._stale:
            return
        self._rare_due, nodes = now + RARE_PERIOD_NS, self.get_nodes()
        if not nodes:  # a callback has shut the executor down
            return
        rare.wait(0)
        if not rare.ready("service") and not rare.ready("client"):
            if now < self._events_due:
                return
            self._events_due = now + EVENT_PERIOD_NS // len(nodes)
            self._turn += 1
            nodes = [nodes[self._turn % len(nodes)]]
        while self._is_running() and self._serve(0.0, nodes):
            pass
        if not self._is_running():  # the shutdown may have woken the public executor instead
            self._stale = True

    def _call_afterwards(self) -> None:
        if self._afterwards:
            callbacks, self._afterwards = self._afterwards, []
            for callback in callbacks:
                callback()

    def _drain(self, subscription: Subscription) -> None:
        take, kind, raw = subscription.handle.take_message, subscription.msg_type, subscription.raw
        wanted = 1 if subscription._callback_type is Subscription.CallbackType.MessageOnly else 2
        for _ in range(_BURST):
            # A subscription that a callback destroyed must not see another message.
            try:
                item = None if self._stale else take(kind, raw)
            except Exception as error:  # the bytes are not a valid message
                self._reject(subscription, subscription.topic_name, error)
                continue
            if item is None:
                return
            subscription.callback(*item[:wanted])

    def _is_running(self) -> bool:
        return bool(self._context.ok()) and not self._is_shutdown

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Serve one entity, as the public executor does."""
        self._serve(timeout_sec)
        self._call_afterwards()

    def _serve(self, timeout_sec: float | None, nodes: list[Node] | None = None) -> bool:
        """Serve one ready entity with the public executor; return whether there was one."""
        try:
            task, *_ = self.wait_for_ready_callbacks(timeout_sec, nodes)
            task()
            task.result()  # re-raises the callback's exception
        except (TimeoutException, ShutdownException):
            return False
        except ExternalShutdownException:
            raise
        except Exception as error:
            self._survive("services", error)
        return True

    # rclpy raises while it takes a request with damaged bytes. That would leave the service and its
    # callback group locked forever.
    def _take_service(self, srv: Service) -> Any:
        try:
            return super()._take_service(srv)
        except Exception as error:
            self._reject(srv, srv.srv_name, error)
            return None

    def _reject(self, entity: Service | Subscription, name: str, error: Exception) -> None:
        """Report unreadable bytes to the owner of the entity."""
        nodes = self.get_nodes()
        owners = [node for node in nodes if entity in (*node.services, *node.subscriptions)]
        text = f"its bytes cannot be read ({type(error).__name__})."
        self._survive(name, MessageError(text), owners)

    def _survive(self, source: str, error: Exception, nodes: Sequence[Node] = ()) -> None:
        """Pass an error to the nodes that it concerns, or to all nodes if that is unknown."""
        survivors = [node for node in nodes or self.get_nodes() if hasattr(node, "survive")]
        if not survivors:
            raise error
        for node in survivors:
            node.survive(source, error)
