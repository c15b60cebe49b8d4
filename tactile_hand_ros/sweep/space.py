# SPDX-License-Identifier: Apache-2.0
"""The parameters of a study, each a range of numbers or a list of values, and its points."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.extras import optional

_FORMS = "LOW..HIGH, LOW..HIGH/LEVELS, LOW..HIGH:log or a list such as A,B,C"


@dataclass(frozen=True)
class Range:
    """The numbers between two bounds.

    Attributes:
        low: Lower bound.
        high: Upper bound, inclusive.
        is_log: Whether the range is sampled uniformly in its logarithm.
        is_whole: Whether only whole numbers are allowed.
        levels: Number of values to try; 0 for any values in the range.
    """

    low: float
    high: float
    is_log: bool = False
    is_whole: bool = False
    levels: int = 0

    def value(self, fraction: float) -> float | int:
        """Return the value at a fraction of the range, 0 to 1."""
        if self.levels:
            fraction = min(int(fraction * self.levels), self.levels - 1) / (self.levels - 1)
        if self.is_whole:
            span = int(self.high) - int(self.low) + 1
            return int(self.low) + min(int(fraction * span), span - 1)
        if self.is_log:
            return float(self.low * (self.high / self.low) ** fraction)
        return float(self.low + fraction * (self.high - self.low))


@dataclass(frozen=True)
class Choice:
    """Some values with equal probability."""

    values: tuple[Any, ...]

    @property
    def levels(self) -> int:
        """Number of values."""
        return len(self.values)

    def value(self, fraction: float) -> Any:
        """Return the value at a fraction of the list, 0 to 1."""
        return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]


Parameter = Range | Choice
Space = Mapping[str, Parameter]
"""The parameters of a study by name, in a fixed order."""


def parse_parameter(text: str, whole: Collection[str] = ()) -> tuple[str, Parameter]:
    """Read ``PATH=LOW..HIGH``, ``PATH=LOW..HIGH/LEVELS``, ``PATH=LOW..HIGH:log`` or ``PATH=A,B,C``.

    `whole` lists the paths whose ranges contain whole numbers only.

    Raises:
        ConfigurationError: If it is none of these, or the range or list is empty.
    """
    path, _, values = text.partition("=")
    if not path or not values:
        raise ConfigurationError(f"--over got '{text}', expected PATH= and {_FORMS}.")
    if ".." in values:
        return path, _range(f"--over {path} got '{values}', expected", values, path in whole)
    inner = values if values.startswith("[") else f"[{values}]"
    found = parse_yaml(inner, f"--over {path}")
    if not isinstance(found, list) or not found:
        raise ConfigurationError(f"--over {path} got '{values}', expected {_FORMS}.")
    return path, Choice(tuple(found))


def _range(refusal: str, text: str, is_whole: bool) -> Range:
    bounds, _, kind = text.partition(":")
    bounds, _, levels = bounds.partition("/")
    low, _, high = bounds.partition("..")
    try:
        found = Range(float(low), float(high), kind == "log", is_whole, int(levels or 0))
    except ValueError:
        raise ConfigurationError(f"{refusal} {_FORMS}.") from None
    wrong = {
        _FORMS: kind not in ("", "log") or not np.isfinite([found.low, found.high]).all(),
        "the lower bound first": not found.low < found.high,
        "bounds above 0 with :log": found.is_log and found.low <= 0.0,
        "2 or more levels": bool(levels) and found.levels < 2,
        "whole numbers": is_whole and not (found.low.is_integer() and found.high.is_integer()),
    }
    for expected, is_wrong in wrong.items():
        if is_wrong:
            raise ConfigurationError(f"{refusal} {expected}.")
    return found


def points(space: Space, runs: int, seed: int) -> Array:
    """Return the runs of a study as points in the unit cube, shape (n, d).

    These are all combinations if every parameter has levels, else a Latin hypercube.
    """
    shape = tuple(parameter.levels for parameter in space.values())
    if all(shape):
        combinations = np.indices(shape).reshape(len(shape), -1).T
        return np.asarray(combinations / np.maximum(1, np.array(shape) - 1))
    qmc = optional("scipy.stats.qmc", "Sampling a study")
    # All supported versions of SciPy accept the name `seed`.
    sampler = qmc.LatinHypercube(d=len(space), seed=np.random.default_rng(seed))
    return np.asarray(sampler.random(runs))
