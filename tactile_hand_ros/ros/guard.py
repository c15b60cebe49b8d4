# SPDX-License-Identifier: Apache-2.0
"""No callback stops a node: what one throws is counted, reported and answered with the safe state.

A message or request that is rejected (`TactileHandError`) costs nothing but itself. Anything else,
and a result that must not be published (`UnsafeOutputError`), was not foreseen: it is reported with
the line of this package that failed, and the node goes to its safe state.
"""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from rcl_interfaces.msg import SetParametersResult

from tactile_hand_ros.errors import TactileHandError, UnsafeOutputError, shortened
from tactile_hand_ros.ros.diagnostics import Diagnostics

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
            callback: The callback; not a coroutine.
        """
        if inspect.iscoroutinefunction(callback):
            return callback

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
        if inspect.iscoroutinefunction(callback):
            return callback

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
