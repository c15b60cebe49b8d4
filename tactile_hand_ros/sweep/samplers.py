# SPDX-License-Identifier: Apache-2.0
"""Where in its space a study runs: samplers of the unit cube from `scipy.stats.qmc`, and a grid.

A sampler gives the same shares for a run whenever it is asked, in slices, so that a study of a
million runs holds a few of them at a time.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.sweep.space import Space

Array = NDArray[np.float64]
Rows = Callable[[int, int], Array]
"""Returns the shares of some runs, from the first to before the last, shape (n, d)."""


@dataclass(frozen=True)
class Design:
    """The runs of a study as points of the unit cube.

    Attributes:
        runs: Number of runs.
        rows: Their shares.
    """

    runs: int
    rows: Rows


def grid(space: Space, runs: int, seed: int) -> Design:
    """Return all combinations of levels; ranges without levels share what `runs` leaves."""
    del seed
    fixed = math.prod(p.levels for p in space.parameters.values() if p.levels)
    free = sum(not p.levels for p in space.parameters.values())
    each = max(2, round((runs / fixed) ** (1.0 / free))) if free else 0
    shape = tuple(p.levels or each for p in space.parameters.values())

    def rows(first: int, last: int) -> Array:
        levels = np.array(np.unravel_index(np.arange(first, last), shape), dtype=float).T
        return np.asarray(levels / np.maximum(1, np.array(shape) - 1))

    return Design(math.prod(shape), rows)


def latin(space: Space, runs: int, seed: int) -> Design:
    """Return a Latin hypercube: every n-th of each parameter holds one of n runs.

    It is drawn as a whole: 8 bytes for each run and parameter.
    """
    qmc = optional("scipy.stats.qmc", "Sampling a study")
    # `seed` is the name that all supported versions of scipy know.
    drawn = qmc.LatinHypercube(d=len(space), seed=np.random.default_rng(seed)).random(runs)
    return Design(runs, lambda first, last: drawn[first:last])


def sobol(space: Space, runs: int, seed: int) -> Design:
    """Return a scrambled Sobol' sequence, which fills the space evenly from the first run on."""
    return Design(runs, _sobol_rows(len(space), seed))


def random(space: Space, runs: int, seed: int) -> Design:
    """Return independent points; those of a longer study begin with those of a shorter one."""

    def rows(first: int, last: int) -> Array:
        seeds = (np.random.SeedSequence([seed, run, 1]) for run in range(first, last))
        drawn = [np.random.default_rng(each).random(len(space)) for each in seeds]
        return np.array(drawn).reshape(-1, len(space))

    return Design(runs, rows)


def saltelli(space: Space, runs: int, seed: int) -> Design:
    """Return the design that Sobol' indices are estimated from: A, B and A with a column of B each.

    Source: Saltelli et al., Variance based sensitivity analysis of model output, 2010, table 2.
    """
    d = len(space)
    n = base_size(runs, d)
    if n < 2:
        raise ConfigurationError(
            f"--runs is {runs}, expected at least {2 * (d + 2)} for Sobol' indices of {d} "
            "parameters."
        )
    both = _sobol_rows(2 * d, seed)(0, n)

    def rows(first: int, last: int) -> Array:
        block, row = np.divmod(np.arange(first, last)[:, None], n)
        from_b = (block == 1) | (block - 2 == np.arange(d))
        return np.asarray(np.where(from_b, both[row[:, 0], d:], both[row[:, 0], :d]))

    return Design(n * (d + 2), rows)


def base_size(runs: int, parameters: int) -> int:
    """Return the size n of A and B, a power of two with n (d + 2) <= runs; 0 if there is none."""
    share = runs // (parameters + 2)
    return 1 << (share.bit_length() - 1) if share else 0


def _sobol_rows(dimensions: int, seed: int) -> Rows:
    qmc = optional("scipy.stats.qmc", "Sampling a study")

    def rows(first: int, last: int) -> Array:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a slice need not be a power of two
            engine = qmc.Sobol(d=dimensions, scramble=True, seed=np.random.default_rng(seed))
            if first:
                engine.fast_forward(first)
            return np.asarray(engine.random(last - first))

    return rows


SAMPLERS: dict[str, Callable[[Space, int, int], Design]] = {
    "grid": grid,
    "latin": latin,
    "sobol": sobol,
    "random": random,
    "saltelli": saltelli,
}
