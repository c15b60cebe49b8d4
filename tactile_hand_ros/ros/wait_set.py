# SPDX-License-Identifier: Apache-2.0
"""What an executor waits on: a lean wait set for messages and timers, a full one for everything.

Waiting on every service and QoS event costs five times as much as waiting on the subscriptions.
So while messages flow the full set gets its turn only every `FULL_PERIOD_NS`; when they pause,
the full set is the one that blocks, and nothing is polled.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
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
    """What a wait found, and whether the public executor must serve something else."""

    guards: list[Any]
    timers: list[Timer]
    subscriptions: list[Subscription]
    has_rare: bool = False


class WaitedEntities:
    """The entities of some nodes, held alive, and the two wait sets over them."""

    def __init__(
        self,
        nodes: Iterable[Node],
        own_guards: Iterable[Any],
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
        self._stack = stack
        self._known: dict[int, Any] = {}
        self._waitables: list[Any] = []
        lean, rare = self._hold("guard_condition", own_guards), []
        for node in nodes:
            slow = [timer for timer in node.timers if timer.timer_period_ns >= _SLOW_TIMER_NS]
            lean += self._hold("subscription", node.subscriptions)
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
        # The public executor serves one thing at a time: look again at once until all is served.
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
