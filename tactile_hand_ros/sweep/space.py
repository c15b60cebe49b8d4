# SPDX-License-Identifier: Apache-2.0
"""What a study varies, each a range of numbers or a choice of values, and where it is run."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.extras import optional

Array = NDArray[np.float64]

_FORMS = "LOW..HIGH, LOW..HIGH/LEVELS, LOW..HIGH:log or a list such as A,B,C"


@dataclass(frozen=True)
class Range:
    """The numbers between two bounds.

    Attributes:
        low: Lower bound.
        high: Upper bound, itself included.
        is_log: Whether equal ratios are equally likely, instead of equal differences.
        is_whole: Whether only whole numbers are meant.
        levels: Values of it that a grid takes; 0 leaves that to the grid.
    """

    low: float
    high: float
    is_log: bool = False
    is_whole: bool = False
    levels: int = 0

    def value(self, fraction: float) -> float | int:
        """Return the value at a fraction of the range, 0 to 1."""
        if self.is_whole:
            span = int(self.high) - int(self.low) + 1
            return int(self.low) + min(int(fraction * span), span - 1)
        if self.is_log:
            return float(self.low * (self.high / self.low) ** fraction)
        return float(self.low + fraction * (self.high - self.low))


@dataclass(frozen=True)
class Choice:
    """Some values, each as likely as the others."""

    values: tuple[Any, ...]

    @property
    def levels(self) -> int:
        """Number of values."""
        return len(self.values)

    def value(self, fraction: float) -> Any:
        """Return the value at a fraction of the list, 0 to 1."""
        return self.values[min(int(fraction * len(self.values)), len(self.values) - 1)]


Parameter = Range | Choice


@dataclass(frozen=True)
class Space:
    """The parameters of a study by name, in a fixed order."""

    parameters: Mapping[str, Parameter]

    def __len__(self) -> int:
        """Return the number of parameters."""
        return len(self.parameters)

    def values(self, fractions: NDArray[np.float64] | Sequence[float]) -> dict[str, Any]:
        """Return the values at a point of the unit cube, one fraction for each parameter."""
        pairs = zip(self.parameters.items(), fractions, strict=True)
        return {name: parameter.value(float(fraction)) for (name, parameter), fraction in pairs}


def parse_parameter(text: str, *, is_whole: bool = False) -> tuple[str, Parameter]:
    """Read ``PATH=LOW..HIGH``, ``PATH=LOW..HIGH/LEVELS``, ``PATH=LOW..HIGH:log`` or ``PATH=A,B,C``.

    Args:
        text: As on the command line.
        is_whole: Whether a range means whole numbers.

    Raises:
        ConfigurationError: If it is none of these, or the range or list is empty.
    """
    path, separator, values = text.partition("=")
    if not separator or not path or not values:
        raise ConfigurationError(f"--over got '{text}', expected PATH= and {_FORMS}.")
    if ".." in values:
        return path, _range(path, values, is_whole)
    inner = values if values.startswith("[") else f"[{values}]"
    found = parse_yaml(inner, f"--over {path}")
    if not isinstance(found, list) or not found:
        raise ConfigurationError(f"--over {path} got '{values}', expected {_FORMS}.")
    return path, Choice(tuple(found))


def _range(path: str, text: str, is_whole: bool) -> Range:
    bounds, _, kind = text.partition(":")
    bounds, _, levels = bounds.partition("/")
    low, _, high = bounds.partition("..")
    try:
        found = Range(float(low), float(high), kind == "log", is_whole, int(levels or 0))
    except ValueError:
        raise ConfigurationError(f"--over {path} got '{text}', expected {_FORMS}.") from None
    if kind not in ("", "log") or not np.isfinite([found.low, found.high]).all():
        raise ConfigurationError(f"--over {path} got '{text}', expected {_FORMS}.")
    if not found.low < found.high:
        raise ConfigurationError(
            f"--over {path} got the empty range {low}..{high}, expected the lower bound first."
        )
    if found.is_log and found.low <= 0.0:
        raise ConfigurationError(f"--over {path} got {text}, expected bounds above 0 with :log.")
    if levels and found.levels < 2:
        raise ConfigurationError(f"--over {path} got {levels} levels, expected 2 or more.")
    if is_whole and not (found.low.is_integer() and found.high.is_integer()):
        raise ConfigurationError(f"--over {path} got {text}, expected whole numbers.")
    return found


def grid(space: Space, runs: int, seed: int) -> Array:
    """Return all combinations of levels; ranges without levels divide what `runs` leaves."""
    del seed
    fixed = math.prod(p.levels for p in space.parameters.values() if p.levels)
    free = sum(not p.levels for p in space.parameters.values())
    each = max(2, round((runs / fixed) ** (1.0 / free))) if free else 0
    shape = tuple(p.levels or each for p in space.parameters.values())
    levels = np.indices(shape).reshape(len(shape), -1).T
    return np.asarray(levels / np.maximum(1, np.array(shape) - 1))


def latin(space: Space, runs: int, seed: int) -> Array:
    """Return a Latin hypercube: every n-th of each parameter holds one of n runs."""
    qmc = optional("scipy.stats.qmc", "Sampling a study")
    # `seed` is the name that all supported versions of scipy know.
    drawn = qmc.LatinHypercube(d=len(space), seed=np.random.default_rng(seed)).random(runs)
    return np.asarray(drawn)


def sobol(space: Space, runs: int, seed: int) -> Array:
    """Return a scrambled Sobol' sequence, which fills the space evenly from the first run on."""
    qmc = optional("scipy.stats.qmc", "Sampling a study")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the number need not be a power of two
        drawn = qmc.Sobol(d=len(space), seed=np.random.default_rng(seed)).random(runs)
    return np.asarray(drawn)


def random(space: Space, runs: int, seed: int) -> Array:
    """Return independent points; those of a longer study begin with those of a shorter one."""
    return np.random.default_rng(seed).random((runs, len(space)))


SAMPLERS: dict[str, Callable[[Space, int, int], Array]] = {
    "grid": grid,
    "latin": latin,
    "sobol": sobol,
    "random": random,
}
"""Each returns the points of a study in the unit cube, shape (n, d)."""
