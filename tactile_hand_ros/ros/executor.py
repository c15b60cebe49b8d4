# SPDX-License-Identifier: Apache-2.0
"""Executor of the nodes: it builds its wait sets once and takes messages directly.

At every wake-up, the standard executors of rclpy build a new wait set and a coroutine per callback.
That costs more than handling the message. `WaitSetExecutor` keeps its wait sets and calls back
directly. Subscriptions, timers and guard conditions are in the one that it waits for. Services and
clients are checked every `RARE_PERIOD_NS`, QoS events every `EVENT_PERIOD_NS`. Callbacks are
plain functions: coroutines are not awaited, and tasks of `create_task` are not run.

Private parts of rclpy (Jazzy) in use:

* ``rclpy.impl.implementation_singleton.rclpy_implementation.WaitSet``: the wait set itself.
* ``take_message``, ``call_timer``, ``is_timer_ready``, ``service_take_request`` and
  ``take_response`` of the objects behind the public ``handle`` of an entity.
* ``Subscription._callback_type``: whether a callback also takes the message info.
* ``Executor._guard``, ``_sigint_gc`` and ``_is_shutdown`` of the base class.

A node with work to do between messages has a method `work`, which returns whether there is more to
do. The executor calls it repeatedly and does not block meanwhile.

A middleware error (an unreadable request, an unsendable reply) is passed to ``survive`` of the
nodes that have one, and does not stop the loop.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
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
"""Maximum wait of a QoS event [ns]; a hand has a hundred that can occur."""

_KINDS = ("subscription", "guard_condition", "timer", "client", "service")
_EVENT = "event"


def _lateness(timer: Timer) -> int:
    """Return how long ago a timer was due, less its period [ns]."""
    return int(-(timer.time_until_next_call() or 0) - timer.timer_period_ns)


def spin(nodes: Sequence[Node]) -> None:
    """Serve nodes of one context until SIGINT, SIGTERM or ``rclpy.shutdown``.

    An exception in a callback propagates.
    """
    executor = WaitSetExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    try:
        executor.spin()
    finally:
        executor.shutdown()


class _WaitSet:
    """A native wait set and its entities, which it keeps alive."""

    def __init__(
        self, entities: Mapping[str, Iterable[Any]], context: Context, stack: ExitStack
    ) -> None:
        """Take the entities, by kind; `stack` keeps them in use until it closes."""
        self._known: dict[int, Any] = {}
        self._events: list[Any] = []
        held: list[tuple[str, Any]] = []
        stack.enter_context(context.handle)
        for kind, each in [(kind, each) for kind, some in entities.items() for each in some]:
            with suppress(InvalidHandle):  # destroyed by another thread in the meantime
                if kind == _EVENT:
                    stack.enter_context(each)
                    self._events.append(each)
                    continue
                stack.enter_context(each.handle)
                self._known[each.handle.pointer] = each
                held.append((kind, each.handle))
        count = Counter(kind for kind, _ in held)
        sizes = (count[kind] for kind in _KINDS)
        self._native = _rclpy.WaitSet(*sizes, len(self._events), context.handle)
        stack.enter_context(self._native)
        self._adding = [(getattr(self._native, f"add_{kind}"), handle) for kind, handle in held]
        self._adding += [(event.add_to_wait_set, self._native) for event in self._events]

    def wait(self, limit_ns: int) -> None:
        """Wait until an entity is ready, or until the limit [ns]."""
        self._native.clear_entities()  # a wait removes entities that are not ready
        for add, handle in self._adding:
            add(handle)
        self._native.wait(limit_ns)

    def ready(self, kind: str) -> list[Any]:
        """Return the entities of a kind that the last wait found ready."""
        if kind == _EVENT:
            return [event for event in self._events if event.is_ready(self._native)]
        return [self._known[at] for at in self._native.get_ready_entities(kind)]


class WaitSetExecutor(Executor):
    """A single-threaded executor that keeps its wait sets; other threads may wake or end it."""

    # The base class reads it at shutdown, even if a signal interrupted its construction.
    _sigint_gc = None

    def __init__(self, *, context: Context | None = None) -> None:
        """Create the executor for a context, by default the global one."""
        self._stale = True
        self._rare_due = self._events_due = 0
        self._afterwards: list[Callable[[], None]] = []
        super().__init__(context=context)

    def wake(self) -> None:
        """Rebuild the wait sets; rclpy calls this when an entity is created or destroyed."""
        self._stale = True
        super().wake()

    def add_node(self, node: Node) -> bool:
        """Serve a node."""
        is_new = bool(super().add_node(node))
        self.wake()  # afterwards: another thread may rebuild at any time
        return is_new

    def remove_node(self, node: Node) -> None:
        """Stop serving a node."""
        super().remove_node(node)
        self.wake()

    def after_reading(self, callback: Callable[[], None]) -> None:
        """Call back once, after all waiting messages have been handled."""
        self._afterwards.append(callback)

    def spin(self) -> None:
        """Execute callbacks until the context or the executor is shut down."""
        while self._is_running():
            with ExitStack() as stack:
                frequent, rare, events = self._wait_sets(stack)
                works = [node.work for node in self.get_nodes() if hasattr(node, "work")]
                is_busy = bool(works)
                while not self._stale:
                    self._step(frequent, 0 if is_busy else RARE_PERIOD_NS)
                    self._look_for_rare(rare, events)
                    is_busy = any([work() for work in works])

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait once, by default without a limit, and serve all that is ready."""
        self._rare_due = self._events_due = 0
        with ExitStack() as stack:
            frequent, rare, events = self._wait_sets(stack)
            self._step(frequent, -1 if timeout_sec is None else round(1e9 * timeout_sec))
            self._look_for_rare(rare, events)

    def _wait_sets(self, stack: ExitStack) -> list[_WaitSet]:
        """Return the wait sets of frequent entities, of services and clients, and of events."""
        self._stale, nodes, context = False, self.get_nodes(), self.context
        guards = [self._guard, self._sigint_gc, *(g for node in nodes for g in node.guards)]
        own = [s for node in nodes for s in node.subscriptions if self.can_execute(s)]
        timers = [timer for node in nodes for timer in node.timers]
        frequent = {"subscription": own, "timer": timers, "guard_condition": guards}
        rare = {
            "client": [client for node in nodes for client in node.clients],
            "service": [service for node in nodes for service in node.services],
        }
        events = {_EVENT: [e for node in nodes for e in node.waitables if self.can_execute(e)]}
        return [_WaitSet(each, context, stack) for each in (frequent, rare, events)]

    def _step(self, waiting: _WaitSet, limit_ns: int) -> None:
        """Wait once, up to a limit [ns], and serve what is ready, but of the timers only one.

        It is that with the earliest deadline. Otherwise ticks would wait for the diagnostics of all
        nodes in turn, or these for ticks that are always late.
        """
        waiting.wait(limit_ns)
        guards = waiting.ready("guard_condition")
        if guards and not self._is_running():
            self._stale = True
        for guard in guards:
            if guard.callback is not None and not self._stale:
                guard.callback()
        # A cancelled timer is reported as ready one more time.
        timers = [timer for timer in waiting.ready("timer") if timer.handle.is_timer_ready()]
        if timers and not self._stale:
            timer = max(timers, key=_lateness)
            timer.handle.call_timer()
            timer.callback()
        for subscription in waiting.ready("subscription"):
            self._drain(subscription)
        if self._afterwards:
            callbacks, self._afterwards = self._afterwards, []
            for callback in callbacks:
                callback()

    def _look_for_rare(self, rare: _WaitSet, events: _WaitSet) -> None:
        """Serve services, clients and QoS events when due."""
        now = time.monotonic_ns()
        if now < self._rare_due or self._stale:
            return
        self._rare_due = now + RARE_PERIOD_NS
        rare.wait(0)
        for service in rare.ready("service"):
            self._serve(service)
        for client in rare.ready("client"):
            take = partial(client.handle.take_response, client.srv_type.Response)
            for header, response in self._taken(client.srv_name, take):
                with suppress(KeyError):  # the request was cancelled
                    number = header.request_id.sequence_number
                    client.get_pending_request(number).set_result(response)
        if now >= self._events_due and not self._stale:
            self._events_due = now + EVENT_PERIOD_NS
            events.wait(0)
            for handler in events.ready(_EVENT):
                handler.callback(handler.take_data())

    def _drain(self, subscription: Subscription) -> None:
        kind, raw = subscription.msg_type, subscription.raw
        wanted = 1 if subscription._callback_type is Subscription.CallbackType.MessageOnly else 2
        take = partial(subscription.handle.take_message, kind, raw)
        for item in self._taken(subscription.topic_name, take):
            subscription.callback(*item[:wanted])

    def _serve(self, service: Service) -> None:
        kind = service.srv_type
        take = partial(service.handle.service_take_request, kind.Request)
        for request, header in self._taken(service.srv_name, take):
            try:
                service.send_response(service.callback(request, kind.Response()), header)
            except Exception as error:
                self._survive("services", error)

    def _taken(self, name: str, take: Callable[[], Any]) -> Iterator[Any]:
        """Yield what waits at an entity; report bytes that cannot be read."""
        for _ in range(_BURST):
            # A subscription that a callback destroyed must not see another message.
            try:
                item = None if self._stale else take()
            except Exception as error:
                text = f"its bytes cannot be read ({type(error).__name__})."
                self._survive(name, MessageError(text))
                continue
            if item is None or item[1] is None:
                return
            yield item

    def _is_running(self) -> bool:
        return bool(self.context.ok()) and not self._is_shutdown

    def _survive(self, source: str, error: Exception) -> None:
        """Pass an error to all nodes that survive errors."""
        survivors = [node for node in self.get_nodes() if hasattr(node, "survive")]
        if not survivors:
            raise error
        for node in survivors:
            node.survive(source, error)
