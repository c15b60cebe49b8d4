# SPDX-License-Identifier: Apache-2.0
"""Results that were saved, and how those of today compare with them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.results import Result, to_json
from tactile_hand_ros.files import replace_text

_CALLS = "function_calls_per_s"


@dataclass(frozen=True)
class Saved:
    """Results of an earlier run; empty where there was none.

    Attributes:
        medians: Median of each measurement by its name.
        calls: Ticks per second that the loop made by function calls then.
    """

    medians: Mapping[str, float] = field(default_factory=dict)
    calls: float = math.nan

    def change(self, result: Result) -> str:
        """Return today's median in units of the saved one, empty where there is none."""
        before = self.medians.get(result.name, 0.0)
        return f"{result.median / before:.2f} x" if before else ""


def load(file: Path) -> Saved:
    """Read saved results; a file that is missing or of another kind counts as none."""
    try:
        content: Any = json.loads(file.read_text(encoding="utf-8"))
        medians = {each["name"]: float(each["median"]) for each in content["results"]}
        return Saved(medians, float(content["machine"].get(_CALLS, math.nan)))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return Saved()


def save(results: Sequence[Result], calls: float, file: Path) -> None:
    """Write results, with the speed of the machine in the same hour.

    Args:
        results: The results.
        calls: Ticks per second that the loop made by function calls.
        file: Where to write.
    """
    content = to_json(results)
    content["machine"][_CALLS] = calls
    replace_text(file, json.dumps(content, indent=2) + "\n")


def speed_line(calls: float, saved: Saved) -> str:
    """Return how fast the machine was, today and then."""
    text = f"Function calls in the same hour: {calls:.0f} ticks/s"
    return text + (f", {saved.calls:.0f} when the saved run was made." if saved.medians else ".")
