# SPDX-License-Identifier: Apache-2.0
"""The health of a node, as a DiagnosticStatus."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from tactile_hand_ros.errors import counted, shortened

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
ERROR, STALE = DiagnosticStatus.ERROR, DiagnosticStatus.STALE

WARN_SECONDS = 5.0
"""How long a rejected message keeps the level at WARN and an error keeps it at ERROR [s]."""

_WINDOW = 4096
"""Number of recent latencies used for the percentiles."""


@dataclass
class _Notes:
    """Count, last reason and times of one kind of problem."""

    count: int = 0
    reason: str = ""
    last: float = -np.inf
    logged: float = -np.inf


class Diagnostics:
    """Counters and values that `status` turns into one DiagnosticStatus.

    All methods except `status` are cheap enough for every tick: well under a microsecond.

    Attributes:
        expects: Topic that brings the ticks; empty for a node without any.
    """

    def __init__(self, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Create the counters of a node; `clock` [s] serves only rates and warning durations."""
        self.name, self.expects = name, ""
        self._clock = clock
        self._ticks = self._reported_ticks = 0
        self._reported_at = clock()
        self._rejections: dict[str, _Notes] = {}
        self._errors: dict[str, _Notes] = {}
        self._values: dict[str, Any] = {}
        self._faults: dict[str, tuple[str, bytes]] = {}
        self._latencies, self._measured = np.empty(_WINDOW), 0  # a ring, s

    def tick(self) -> None:
        """Count one tick."""
        self._ticks += 1

    def latency(self, seconds: float) -> None:
        """Record the duration of one tick [s]."""
        self._latencies[self._measured % _WINDOW] = seconds
        self._measured += 1

    def value(self, key: str, value: Any) -> None:
        """Set a reported value, such as a margin or a residual."""
        self._values[key] = value

    def fault(self, key: str, message: str, level: bytes = ERROR) -> None:
        """Report a fault until `clear` is called with the same key."""
        self._faults[key] = (message, level)

    def judge(self, key: str, is_fault: bool, message: str, level: bytes = ERROR) -> None:
        """Report or clear a fault."""
        if is_fault:
            self.fault(key, message, level)
        else:
            self.clear(key)

    def clear(self, key: str) -> None:
        """Clear a fault, if it is set."""
        self._faults.pop(key, None)

    def reject(self, topic: str, error: Exception | str) -> bool:
        """Count a rejected message; return whether to log it, at most once per `WARN_SECONDS`."""
        return self._note(self._rejections, topic, error)

    def error(self, source: str, text: str) -> bool:
        """Count an unexpected error; return whether to log it, at most once per `WARN_SECONDS`."""
        return self._note(self._errors, source, text)

    def _note(self, entries: dict[str, _Notes], key: str, error: Exception | str) -> bool:
        entry, now = entries.setdefault(key, _Notes()), self._clock()
        entry.count, entry.reason, entry.last = entry.count + 1, shortened(error), now
        is_due = now - entry.logged >= WARN_SECONDS
        if is_due:
            entry.logged = now
        return is_due

    def status(self) -> DiagnosticStatus:
        """Return the status of the time since the last call."""
        now = self._clock()
        ticks, seconds = self._ticks - self._reported_ticks, now - self._reported_at
        self._reported_ticks, self._reported_at = self._ticks, now
        level, message = self._worst(now, ticks)
        rate = ticks / seconds if seconds > 0.0 else 0.0
        facts: dict[str, Any] = {"ticks": self._ticks, "rate_hz": f"{rate:.1f}"}
        facts |= self._percentiles() | self._values
        for topic, entry in self._rejections.items():
            facts[f"rejected {topic}"] = entry.count
            facts[f"last reason {topic}"] = entry.reason
        for source, entry in self._errors.items():
            facts[f"errors {source}"] = entry.count
            facts[f"last error {source}"] = entry.reason
        facts |= {f"fault {key}": text for key, (text, _) in self._faults.items()}
        pairs = [KeyValue(key=key, value=_text(value)) for key, value in facts.items()]
        return DiagnosticStatus(level=level, name=self.name, message=message, values=pairs)

    def _worst(self, now: float, ticks: int) -> tuple[bytes, str]:
        """Return level and text of the worst problem; at equal level a fault comes first."""
        found = [(level, text) for text, level in self._faults.values()]
        for source, entry in _latest(self._errors, now):
            found.append((ERROR, f"{counted(entry.count, 'error')} in {source}: {entry.reason}"))
        for topic, entry in _latest(self._rejections, now):
            count = counted(entry.count, "message")
            found.append((WARN, f"{count} on {topic} rejected: {entry.reason}"))
        level, text = max(found, key=lambda each: each[0], default=(OK, "running"))
        if ticks or not (self._ticks or self.expects):
            return level, text
        silence = f"no new tick, {self._ticks} so far"
        if not self._ticks:
            silence = f"no tick yet: no {self.expects}, or not all that belongs to it"
        if not found:
            return STALE, silence
        return level, f"{text}; {silence}" if self.expects else text

    def _percentiles(self) -> dict[str, str]:
        if not self._measured:
            return {}
        recent = self._latencies[: self._measured]
        marks = np.percentile(recent, (50, 99, 100), method="nearest")
        named = zip(("p50", "p99", "max"), marks, strict=True)
        return {f"latency_{name}_us": f"{1e6 * mark:.0f}" for name, mark in named}


def _latest(entries: dict[str, _Notes], now: float) -> list[tuple[str, _Notes]]:
    """Return the newest entry, or an empty list if it is older than `WARN_SECONDS`."""
    recent = [item for item in entries.items() if now - item[1].last < WARN_SECONDS]
    return sorted(recent, key=lambda item: item[1].last)[-1:]


class Mostly:
    """Majority filter: whether a condition held in most ticks since the last call.

    Noise makes a condition flicker. A report once a second should show only lasting conditions.
    """

    def __init__(self) -> None:
        """Start with False."""
        self._held = self._ticks = 0
        self._answer = False

    def note(self, holds: bool) -> None:
        """Count a tick."""
        self._held += holds
        self._ticks += 1

    def __call__(self) -> bool:
        """Return the majority since the last call, or the previous result if there was no tick."""
        if self._ticks:
            self._answer = 2 * self._held > self._ticks
            self._held = self._ticks = 0
        return self._answer


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
