# SPDX-License-Identifier: Apache-2.0
"""The nodes' own loop: one wait set, built once, and messages taken directly.

The standard executors of rclpy build a new wait set and a coroutine per callback at every
wake-up, which costs more than the message itself. `WaitSetExecutor` keeps one wait set and calls
subscriptions, timers and guard conditions directly. Everything rare (services, clients, QoS
events) has its turn every `RARE_PERIOD_NS` in the inherited, public `SingleThreadedExecutor`.
Callbacks are plain functions: coroutines are not awaited.

Pieces of rclpy (Jazzy) that are not public:

* ``rclpy.impl.implementation_singleton.rclpy_implementation.WaitSet``: the wait set itself.
* ``take_message``, ``call_timer`` and ``is_timer_ready`` of the objects behind the public
  ``handle`` of subscriptions and timers.
* ``Subscription._callback_type``: whether a callback takes the message's info too.
* ``Executor._take_service``, ``_guard``, ``_sigint_gc`` and ``_is_shutdown`` of the base class.

A node that has work of its own to do between messages has a function `work`. It is called again and
again, and returns whether there is more; the executor does not block meanwhile.

An error of the middleware (a request that cannot be taken, an answer that cannot be sent) goes to
``survive`` of the nodes that have it, and does not stop the loop.
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
"""Messages taken from one subscription before the others get their turn."""

RARE_PERIOD_NS = 50_000_000
"""Longest time a service request or QoS event waits [ns]: looking for them costs a millisecond."""


def spin(nodes: Node | Sequence[Node], executor: Executor | None = None) -> None:
    """Serve one or several nodes of one context until it is shut down.

    Returns normally after SIGINT, SIGTERM or ``rclpy.shutdown``. An exception of a callback stops
    the loop and is passed on.

    Args:
        nodes: The nodes.
        executor: Executor to use; by default a new `WaitSetExecutor`.
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
    """The frequent entities of some nodes, held alive, and one native wait set over them."""

    def __init__(
        self, entities: Mapping[str, Iterable[Any]], context: Context, stack: ExitStack
    ) -> None:
        """Collect the entities.

        Args:
            entities: What to wait for, by its kind in rclpy.
            context: Context of all nodes.
            stack: Keeps every handle in use until it is closed.
        """
        self._known: dict[int, Any] = {}
        held: list[tuple[str, Any]] = []
        stack.enter_context(context.handle)
        for kind, each in ((kind, each) for kind, some in entities.items() for each in some):
            with suppress(InvalidHandle):  # destroyed by another thread in the meantime
                stack.enter_context(each.handle)
                self._known[each.handle.pointer] = each
                held.append((kind, each.handle))
        count = Counter(kind for kind, _ in held)
        sizes = [count[kind] for kind in ("subscription", "guard_condition", "timer")]
        self._native = _rclpy.WaitSet(*sizes, 0, 0, 0, context.handle)
        stack.enter_context(self._native)
        self._adding = [(getattr(self._native, f"add_{kind}"), handle) for kind, handle in held]

    def wait(self, limit_ns: int) -> None:
        """Wait until something is ready, at most for a time [ns]."""
        self._native.clear_entities()  # a wait removes what is not ready
        for add, handle in self._adding:
            add(handle)
        self._native.wait(limit_ns)

    def ready(self, kind: str) -> list[Any]:
        """Return what the last wait found of a kind."""
        return [self._known[at] for at in self._native.get_ready_entities(kind)]


class WaitSetExecutor(SingleThreadedExecutor):
    """A single-threaded executor that keeps its wait set.

    Not for use from several threads, except `wake` and `shutdown`.
    """

    # The base class looks for it at shutdown, also when a signal cut its construction short.
    _sigint_gc = None

    def __init__(self, *, context: Context | None = None) -> None:
        """Create the executor for a context, by default the global one."""
        self._stale = True
        self._spins = False
        self._rare_due = 0
        self._afterwards: list[Callable[[], None]] = []
        super().__init__(context=context)

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

    def can_execute(self, entity: Any) -> bool:
        """Return whether the public executor serves an entity; only rare ones during `spin`."""
        is_frequent = isinstance(entity, Subscription | Timer | GuardCondition)
        return not (self._spins and is_frequent) and bool(super().can_execute(entity))

    def spin(self) -> None:
        """Execute callbacks until the context or the executor is shut down."""
        while self._is_running():
            with ExitStack() as stack:
                waiting = self._entities(stack)
                works = [node.work for node in self.get_nodes() if hasattr(node, "work")]
                is_busy = bool(works)
                while not self._stale:
                    self._step(waiting, 0 if is_busy else RARE_PERIOD_NS)
                    is_busy = any([work() for work in works])

    def _entities(self, stack: ExitStack) -> _WaitSet:
        self._stale, self._spins = False, False
        nodes = self.get_nodes()
        guards = [self._guard, self._sigint_gc, *(g for node in nodes for g in node.guards)]
        own = [s for node in nodes for s in node.subscriptions if self.can_execute(s)]
        timers = [timer for node in nodes for timer in node.timers]
        self._spins = True
        kinds = {"subscription": own, "timer": timers, "guard_condition": guards}
        return _WaitSet(kinds, self._context, stack)

    def _step(self, waiting: _WaitSet, limit_ns: int) -> None:
        """Wait once, at most for a time [ns], and serve what is ready."""
        waiting.wait(limit_ns)
        guards = waiting.ready("guard_condition")
        if guards and not self._is_running():
            self._stale = True
        for guard in guards:
            if guard.callback is not None and not self._stale:
                guard.callback()
        for timer in waiting.ready("timer"):
            # A cancelled timer is reported as ready once more.
            if not self._stale and timer.handle.is_timer_ready():
                timer.handle.call_timer()
                timer.callback()
        for subscription in waiting.ready("subscription"):
            self._drain(subscription)
        self._call_afterwards()
        if time.monotonic_ns() >= self._rare_due:
            while self._is_running() and self._serve(0.0):
                pass
            if not self._is_running():  # its guard condition may have woken the public executor
                self._stale = True
            self._rare_due = time.monotonic_ns() + RARE_PERIOD_NS

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
            except Exception as error:  # bytes that are not this message
                self._reject(subscription, subscription.topic_name, error)
                continue
            if item is None:
                return
            subscription.callback(*item[:wanted])

    def _is_running(self) -> bool:
        return bool(self._context.ok()) and not self._is_shutdown

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Serve one thing, as the public executor does."""
        self._serve(timeout_sec)
        self._call_afterwards()

    def _serve(self, timeout_sec: float | None) -> bool:
        """Return whether the public executor has found something to serve."""
        try:
            task, *_ = self.wait_for_ready_callbacks(timeout_sec)
            task()
            task.result()  # raises what the callback raised
        except (TimeoutException, ShutdownException):
            return False
        except ExternalShutdownException:
            raise
        except Exception as error:
            self._survive("services", error)
        return True

    # A request of damaged bytes makes rclpy raise while it takes it, which would leave the service
    # and its callback group locked for ever.
    def _take_service(self, srv: Service) -> Any:
        try:
            return super()._take_service(srv)
        except Exception as error:
            self._reject(srv, srv.srv_name, error)
            return None

    def _reject(self, entity: Service | Subscription, name: str, error: Exception) -> None:
        """Report bytes that cannot be read to the owner of the entity."""
        nodes = self.get_nodes()
        owners = [node for node in nodes if entity in (*node.services, *node.subscriptions)]
        text = f"its bytes cannot be read ({type(error).__name__})."
        self._survive(name, MessageError(text), owners)

    def _survive(self, source: str, error: Exception, nodes: Sequence[Node] = ()) -> None:
        """Let the nodes that an error concerns survive it; all where that is not known."""
        survivors = [node for node in nodes or self.get_nodes() if hasattr(node, "survive")]
        if not survivors:
            raise error
        for node in survivors:
            node.survive(source, error)
