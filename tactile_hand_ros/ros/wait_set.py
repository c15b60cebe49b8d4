# SPDX-License-Identifier: Apache-2.0
"""What an executor waits on: a lean wait set for messages and timers, a full one for everything.

Waiting on every service and QoS event costs five times as much as waiting on the subscriptions.
So while messages flow the full set gets its turn only every `FULL_PERIOD_NS`; when they pause,
the full set is the one that blocks, and nothing is polled.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Iterable
from contextlib import ExitStack
from typing import Any, NamedTuple

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.waitable import NumberOfEntities

FULL_PERIOD_NS = 20_000_000
"""Longest time a service request or QoS event waits while messages flow [ns]."""

_SLOW_TIMER_NS = 5 * FULL_PERIOD_NS
"""Timers of at least this period have only their turn in the full set [ns]."""

WAIT_LIMIT_NS = 1_000_000_000
"""Longest uninterrupted wait [ns]: a lost wake-up costs a second instead of a hang."""


class Ready(NamedTuple):
    """What a wait found: pointers to handles, and whether the public executor must serve more."""

    guards: list[int]
    timers: list[int]
    subscriptions: list[int]
    has_left: bool = False


class WaitedEntities:
    """The entities of some nodes, held alive, and the two wait sets over them.

    Attributes:
        subscriptions: Subscriptions with a plain callback, by pointer.
        timers: Timers with a plain callback, by pointer.
        guards: Guard conditions of the nodes, by pointer.
    """

    def __init__(
        self,
        nodes: Iterable[Node],
        own_guards: Iterable[GuardCondition],
        context: Context,
        stack: ExitStack,
    ) -> None:
        """Collect the entities.

        Args:
            nodes: Nodes to serve.
            own_guards: Guard conditions that only wake the executor.
            context: Context of all nodes.
            stack: Keeps every handle in use until it is closed.
        """
        self.subscriptions: dict[int, Subscription] = {}
        self.timers: dict[int, Timer] = {}
        self.guards: dict[int, GuardCondition] = {}
        self._stack = stack
        self._waitables: list[Any] = []
        self._left: dict[str, set[int]] = {"subscriptions": set(), "timers": set()}
        lean, rare = _Entries(), _Entries()
        for guard in own_guards:
            self._hold(lean.guards, guard)
        for node in nodes:
            self._collect(node, lean, rare)
        stack.enter_context(context.handle)
        self._lean = _WaitSet(lean, [], context, stack)
        self._full = _WaitSet(lean + rare, self._waitables, context, stack)
        self._full_due = 0

    def _collect(self, node: Node, lean: _Entries, rare: _Entries) -> None:
        for subscription in node.subscriptions:
            if self._hold(lean.subscriptions, subscription):
                self._sort(subscription, "subscriptions", self.subscriptions)
        for timer in node.timers:
            slow = timer.timer_period_ns >= _SLOW_TIMER_NS
            if self._hold((rare if slow else lean).timers, timer):
                self._sort(timer, "timers", self.timers)
        for guard in node.guards:
            if self._hold(lean.guards, guard):
                self.guards[guard.handle.pointer] = guard
        for client in node.clients:
            self._hold(rare.clients, client)
        for service in node.services:
            self._hold(rare.services, service)
        for waitable in node.waitables:
            self._hold_waitable(waitable)

    def _hold(self, handles: list[Any], entity: Any) -> bool:
        try:
            self._stack.enter_context(entity.handle)
        except InvalidHandle:  # destroyed by another thread in the meantime
            return False
        handles.append(entity.handle)
        return True

    def _hold_waitable(self, waitable: Any) -> None:
        try:
            self._stack.enter_context(waitable)
        except InvalidHandle:
            return
        self._waitables.append(waitable)

    def _sort(self, entity: Any, kind: str, direct: dict[int, Any]) -> None:
        if inspect.iscoroutinefunction(entity.callback):
            self._left[kind].add(entity.handle.pointer)
        else:
            direct[entity.handle.pointer] = entity

    def wait(self) -> Ready:
        """Wait until something is ready, and tell what."""
        if time.monotonic_ns() < self._full_due:
            ready = self._found(self._lean.wait(FULL_PERIOD_NS))
            if ready.subscriptions or ready.timers or ready.guards:
                return ready
        native = self._full.wait(WAIT_LIMIT_NS)
        is_rare = self._is_rare(native)
        # The public executor serves one thing at a time: look again at once until all is served.
        self._full_due = 0 if is_rare else time.monotonic_ns() + FULL_PERIOD_NS
        ready = self._found(native)
        return ready._replace(has_left=True) if is_rare else ready

    def _found(self, native: Any) -> Ready:
        get = native.get_ready_entities
        ready = Ready(get("guard_condition"), get("timer"), get("subscription"))
        is_left = any(
            pointers and not pointers.isdisjoint(getattr(ready, kind))
            for kind, pointers in self._left.items()
        )
        return ready._replace(has_left=True) if is_left else ready

    def _is_rare(self, native: Any) -> bool:
        if native.get_ready_entities("service") or native.get_ready_entities("client"):
            return True
        # All are asked: each notes for itself that it is ready.
        return any([waitable.is_ready(native) for waitable in self._waitables])


class _Entries:
    """Handles by kind."""

    def __init__(self) -> None:
        self.subscriptions: list[Any] = []
        self.guards: list[Any] = []
        self.timers: list[Any] = []
        self.clients: list[Any] = []
        self.services: list[Any] = []

    def __add__(self, other: _Entries) -> _Entries:
        both = _Entries()
        for name, handles in vars(both).items():
            handles += getattr(self, name) + getattr(other, name)
        return both


class _WaitSet:
    """One native wait set and what goes into it."""

    def __init__(
        self, entries: _Entries, waitables: list[Any], context: Context, stack: ExitStack
    ) -> None:
        more = NumberOfEntities()
        for waitable in waitables:
            more += waitable.get_num_entities()
        self._native = native = _rclpy.WaitSet(
            len(entries.subscriptions) + more.num_subscriptions,
            len(entries.guards) + more.num_guard_conditions,
            len(entries.timers) + more.num_timers,
            len(entries.clients) + more.num_clients,
            len(entries.services) + more.num_services,
            more.num_events,
            context.handle,
        )
        stack.enter_context(native)
        self._waitables = waitables
        self._adding = [
            *((native.add_subscription, handle) for handle in entries.subscriptions),
            *((native.add_guard_condition, handle) for handle in entries.guards),
            *((native.add_timer, handle) for handle in entries.timers),
            *((native.add_client, handle) for handle in entries.clients),
            *((native.add_service, handle) for handle in entries.services),
        ]

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
