# SPDX-License-Identifier: Apache-2.0
"""The nodes' own loop: one wait set, built once, and messages taken directly.

The standard executors of rclpy build a new wait set and a coroutine per callback at every
wake-up, which costs more than the message itself. `WaitSetExecutor` keeps one wait set and calls
subscriptions, timers and guard conditions directly. Everything rare (services, clients, QoS
events) is handed to the inherited, public `SingleThreadedExecutor`. Callbacks are plain functions:
coroutines are not awaited.

Pieces of rclpy (Jazzy) that are not public:

* ``rclpy.impl.implementation_singleton.rclpy_implementation.WaitSet``: the wait set itself.
* ``take_message``, ``call_timer`` and ``is_timer_ready`` of the objects behind the public
  ``handle`` of subscriptions and timers.
* ``Subscription._callback_type``: whether a callback takes the message's info too.
* ``Executor._take_service``, ``_guard``, ``_sigint_gc`` and ``_is_shutdown`` of the base class.

While messages flow, the full wait set, which also has every service and QoS event, gets its turn
only every `FULL_PERIOD_NS`, because waiting on it costs five times as much. When they pause, it is
the one that blocks, and nothing is polled.

A node that has work of its own to do between messages has a function `work`. It is called again and
again, and returns whether there is more; the executor does not block meanwhile.

An error of the middleware (a request that cannot be taken, an answer that cannot be sent) goes to
``survive`` of the nodes that have it, and does not stop the loop.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
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
from rclpy.timer import Timer
from rclpy.waitable import NumberOfEntities

from tactile_hand_ros.errors import MessageError

_BURST = 100
"""Messages taken from one subscription before the others get their turn."""

FULL_PERIOD_NS = 20_000_000
"""Longest time a service request or QoS event waits while messages flow [ns]."""

_SLOW_TIMER_NS = 5 * FULL_PERIOD_NS
"""Timers of at least this period have only their turn in the full set [ns]."""

WAIT_LIMIT_NS = 1_000_000_000
"""Longest uninterrupted wait [ns]: a lost wake-up costs a second instead of a hang."""


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


class Ready(NamedTuple):
    """What a wait found, and whether the public executor must serve something else."""

    guards: list[Any]
    timers: list[Timer]
    subscriptions: list[Subscription]
    has_rare: bool = False


class WaitedEntities:
    """The entities of some nodes, held alive, and the two wait sets over them."""

    def __init__(
        self,
        executor: Executor,
        own_guards: Iterable[Any],
        context: Context,
        stack: ExitStack,
    ) -> None:
        """Collect the entities.

        Args:
            executor: Serves the nodes.
            own_guards: Guard conditions that only wake the executor.
            context: Context of all nodes.
            stack: Keeps every handle in use until it is closed.
        """
        nodes = list(executor.get_nodes())
        self._stack = stack
        self._known: dict[int, Any] = {}
        self._waitables: list[Any] = []
        lean, rare = self._hold("guard_condition", own_guards), []
        for node in nodes:
            slow = [timer for timer in node.timers if timer.timer_period_ns >= _SLOW_TIMER_NS]
            lean += self._hold("subscription", filter(executor.can_execute, node.subscriptions))
            lean += self._hold("timer", (timer for timer in node.timers if timer not in slow))
            lean += self._hold("guard_condition", node.guards)
            rare += self._hold("timer", slow)
            rare += self._hold("client", node.clients)
            rare += self._hold("service", node.services)
            for waitable in node.waitables:
                with suppress(InvalidHandle):
                    stack.enter_context(waitable)
                    self._waitables.append(waitable)
        stack.enter_context(context.handle)
        self._lean = _WaitSet(lean, [], context, stack)
        self._full = _WaitSet(lean + rare, self._waitables, context, stack)
        self._full_due = 0

    def _hold(self, kind: str, entities: Iterable[Any]) -> list[tuple[str, Any]]:
        """Hold entities alive and return kind and handle of each."""
        held = []
        for entity in entities:
            with suppress(InvalidHandle):  # destroyed by another thread in the meantime
                self._stack.enter_context(entity.handle)
                self._known[entity.handle.pointer] = entity
                held.append((kind, entity.handle))
        return held

    def wait(self, limit_ns: int) -> Ready:
        """Wait until something is ready, at most for a time [ns], and return it."""
        if time.monotonic_ns() < self._full_due:
            ready = self._found(self._lean.wait(min(limit_ns, FULL_PERIOD_NS)))
            if not limit_ns or ready.subscriptions or ready.timers or ready.guards:
                return ready
        native = self._full.wait(limit_ns)
        is_rare = self._is_rare(native)
        # The public executor serves one thing at a time: look again until all is served.
        self._full_due = 0 if is_rare else time.monotonic_ns() + FULL_PERIOD_NS
        return self._found(native, has_rare=is_rare)

    def _found(self, native: Any, *, has_rare: bool = False) -> Ready:
        get = native.get_ready_entities
        guards, timers = self._with(get("guard_condition")), self._with(get("timer"))
        return Ready(guards, timers, self._with(get("subscription")), has_rare)

    def _with(self, pointers: list[int]) -> list[Any]:
        """Return the entities with these pointers; others belong to waitables, which are rare."""
        known = self._known
        return [known[at] for at in pointers if at in known] if pointers else []

    def _is_rare(self, native: Any) -> bool:
        if native.get_ready_entities("service") or native.get_ready_entities("client"):
            return True
        # All are asked: each notes for itself that it is ready.
        return any([waitable.is_ready(native) for waitable in self._waitables])


class _WaitSet:
    """One native wait set and what goes into it."""

    def __init__(
        self,
        entries: list[tuple[str, Any]],
        waitables: list[Any],
        context: Context,
        stack: ExitStack,
    ) -> None:
        own = Counter(kind for kind, _ in entries)
        more = sum((waitable.get_num_entities() for waitable in waitables), NumberOfEntities())
        self._native = _rclpy.WaitSet(
            own["subscription"] + more.num_subscriptions,
            own["guard_condition"] + more.num_guard_conditions,
            own["timer"] + more.num_timers,
            own["client"] + more.num_clients,
            own["service"] + more.num_services,
            more.num_events,
            context.handle,
        )
        stack.enter_context(self._native)
        self._waitables = waitables
        self._adding = [(getattr(self._native, f"add_{kind}"), handle) for kind, handle in entries]

    def wait(self, limit_ns: int) -> Any:
        """Wait; this empties the native set of what is not ready, so it is filled each time."""
        native = self._native
        native.clear_entities()
        for add, handle in self._adding:
            add(handle)
        for waitable in self._waitables:
            waitable.add_to_wait_set(native)
        native.wait(limit_ns)
        return native


class WaitSetExecutor(SingleThreadedExecutor):
    """A single-threaded executor that keeps its wait set.

    Not for use from several threads, except `wake` and `shutdown`.
    """

    # The base class looks for it at shutdown, also when a signal cut its construction short.
    _sigint_gc = None

    def __init__(self, *, context: Context | None = None) -> None:
        """Create the executor for a context, by default the global one."""
        self._stale = True
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

    def spin(self) -> None:
        """Execute callbacks until the context or the executor is shut down."""
        while self._is_running():
            self._stale = False
            guards = (self._guard, self._sigint_gc)
            with ExitStack() as stack:
                entities = WaitedEntities(self, guards, self._context, stack)
                works = [node.work for node in self.get_nodes() if hasattr(node, "work")]
                limit = 0 if works else WAIT_LIMIT_NS
                while not self._stale:
                    self._step(entities, limit)
                    if works:
                        limit = 0 if any([work() for work in works]) else WAIT_LIMIT_NS

    def _step(self, entities: WaitedEntities, limit_ns: int) -> None:
        """Wait once, at most for a time [ns], and serve what is ready."""
        ready = entities.wait(limit_ns)
        if ready.guards and not self._is_running():
            self._stale = True
        for guard in ready.guards:
            if guard.callback is not None and not self._stale:
                guard.callback()
        for timer in ready.timers:
            # A cancelled timer is reported as ready once more.
            if not self._stale and timer.handle.is_timer_ready():
                timer.handle.call_timer()
                timer.callback()
        for subscription in ready.subscriptions:
            self._drain(subscription)
        self._call_afterwards()
        if ready.has_rare and not self._stale:
            self.spin_once(timeout_sec=0)

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
        try:
            super().spin_once(timeout_sec)
        except (ExternalShutdownException, ShutdownException):
            raise
        except Exception as error:
            self._survive("services", error)
        self._call_afterwards()

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
