# SPDX-License-Identifier: Apache-2.0
"""The parameters of a study, each a range of numbers or a list of values, and its points."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.extras import optional

_MOST = 100_000  # values of a range, each of which is a run
_FORMS = "LOW..HIGH, LOW..HIGH/LEVELS, LOW..HIGH:log or a list such as A,B,C"


@dataclass(frozen=True)
class Range:
    """The numbers from `low` to `high`, uniform in their logarithm if `is_log`."""

    low: float
    high: float
    is_log: bool = False

    def value(self, fraction: float) -> float:
        """Return the value at a fraction of the range, 0 to 1."""
        if self.is_log:
            return float(self.low * (self.high / self.low) ** fraction)
        return float(self.low + fraction * (self.high - self.low))


@dataclass(frozen=True)
class Choice:
    """Some values with equal probability."""

    values: Sequence[Any]

    def value(self, fraction: float) -> Any:
        """Return the value at a fraction of the list, 0 to 1."""
        return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]


Parameter = Range | Choice
Space = Mapping[str, Parameter]
"""The parameters of a study by name, in a fixed order."""


def parse_parameter(text: str, whole: Collection[str] = ()) -> tuple[str, Parameter]:
    """Read ``PATH=LOW..HIGH``, ``PATH=LOW..HIGH/LEVELS``, ``PATH=LOW..HIGH:log`` or ``PATH=A,B,C``.

    A range of a path in `whole` is the choice of its whole numbers.

    Raises:
        ConfigurationError: If it is none of these, or the range or list is empty.
    """
    path, _, values = text.partition("=")
    if not path or not values:
        raise ConfigurationError(f"--over got '{text}', expected PATH= and {_FORMS}.")
    if ".." in values and not set("[,") & set(values):  # a list may name files such as ../a.yaml
        return path, _range(f"--over {path} got '{values}', expected", values, path in whole)
    inner = values if values.startswith("[") else f"[{values}]"
    found = parse_yaml(inner, f"--over {path}")
    if not isinstance(found, list) or not found:
        raise ConfigurationError(f"--over {path} got '{values}', expected {_FORMS}.")
    return path, Choice(tuple(found))


def _range(refusal: str, text: str, is_whole: bool) -> Parameter:
    bounds, _, kind = text.partition(":")
    bounds, _, levels = bounds.partition("/")
    low, _, high = bounds.partition("..")
    try:
        found, count = Range(float(low), float(high), kind == "log"), int(levels or 2)
    except ValueError:
        raise ConfigurationError(f"{refusal} {_FORMS}.") from None
    wrong = {
        _FORMS: kind not in ("", "log") or not np.isfinite([found.low, found.high]).all(),
        "the lower bound first": not found.low < found.high,
        "bounds above 0 with :log": found.is_log and found.low <= 0.0,
        "2 or more levels": count < 2,
        f"at most {_MOST} levels": count > _MOST,
        "whole numbers": is_whole and not (found.low.is_integer() and found.high.is_integer()),
        f"at most {_MOST} whole numbers": is_whole and found.high - found.low >= _MOST,
    }
    for expected, is_wrong in wrong.items():
        if is_wrong:
            raise ConfigurationError(f"{refusal} {expected}.")
    if levels:
        steps = [found.value(i / (count - 1)) for i in range(count)]
        return Choice(list(dict.fromkeys(map(round, steps))) if is_whole else steps)
    return Choice(range(int(found.low), int(found.high) + 1)) if is_whole else found


def points(space: Space, runs: int, seed: int) -> Array:
    """Return the runs of a study as points in the unit cube, shape (n, d).

    These are all combinations if every parameter is a choice, else a Latin hypercube.
    """
    choices = [each.values for each in space.values() if isinstance(each, Choice)]
    if len(choices) == len(space):
        shape = [len(values) for values in choices]
        combinations = np.indices(shape).reshape(len(shape), -1).T
        return np.asarray(combinations / np.maximum(1, np.array(shape) - 1))
    qmc = optional("scipy.stats.qmc", "Sampling a study")
    # All supported versions of SciPy accept the name `seed`.
    sampler = qmc.LatinHypercube(d=len(space), seed=np.random.default_rng(seed))
    return np.asarray(sampler.random(runs))
