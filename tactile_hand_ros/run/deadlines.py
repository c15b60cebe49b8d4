# SPDX-License-Identifier: Apache-2.0
"""How a run kept to real time, from what its plant counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tactile_hand_ros import names


@dataclass(frozen=True)
class Deadlines:
    """Ticks of a run in real time; NaN where the plant has not reported.

    Attributes:
        rate_hz: Ticks per second that were asked for.
        due: Number of ticks that should have been by the wall clock.
        late: Ticks whose command came after the next tick was due, or not at all.
        skipped: Ticks that came due together with a later one.
        given_up: Ticks for which the machine stood still, or that a failed run never reached.
        causes: How many ticks were late or skipped, by cause.
        too_slow: What the plant says about a computer that is too slow; empty if it is not.
    """

    rate_hz: float
    due: float
    late: float
    skipped: float
    given_up: float
    causes: Mapping[str, int]
    too_slow: str

    @property
    def missed_share(self) -> float:
        """Share of the ticks that were not answered in time, from 0 to 1."""
        return float(np.minimum(1.0, (self.late + self.skipped + self.given_up) / self.due))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {**asdict(self), "missed_share": self.missed_share}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Deadlines:
        """Read what `to_dict` gave; numbers that JSON could not hold are NaN again."""
        numbers = ("rate_hz", "due", "late", "skipped", "given_up")
        known = {key: np.nan if data[key] is None else float(data[key]) for key in numbers}
        return cls(**known, causes=data["causes"], too_slow=data["too_slow"])


def read_deadlines(
    facts: Mapping[str, str], rate: float, asked: float, reached: float
) -> Deadlines:
    """Read what a plant reported; its last report may be a little older than the end of the run.

    Args:
        facts: The values in its last diagnostics.
        rate: Ticks per second that were asked for [Hz].
        asked: Simulated time that was asked for [s].
        reached: Simulated time that the run reached [s].
    """

    def number(key: str) -> float:
        return float(facts.get(key, "nan"))

    never_came = max(0.0, asked - max(reached, number("time_s"))) * rate
    stood_still = number("lost_s") * rate
    return Deadlines(
        rate_hz=rate,
        due=number("time_s") * rate + stood_still + never_came,
        late=number("late_commands"),
        skipped=number("missed_ticks"),
        given_up=stood_still + never_came,
        causes={
            key.removeprefix(names.LATE_FOR): int(value)
            for key, value in facts.items()
            if key.startswith(names.LATE_FOR) and int(value)
        },
        too_slow=facts.get(names.TOO_SLOW, ""),
    )
