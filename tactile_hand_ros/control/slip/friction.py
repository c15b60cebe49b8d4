# SPDX-License-Identifier: Apache-2.0
"""The friction coefficients of the contacts, learned from slips and sticks."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, Row, Rows, compiled, row_of
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.slip.detector import LONGEST, ContactState
from tactile_hand_ros.rotations import dot

_SAMPLES = 10  # of a slip that count; later ones may have stopped already
_AFTERSHOCKS = 0.05  # s in which another alarm belongs to the same slip
_EXACT = 0.1  # relative error of a slip's force ratio without noise
_SMALLEST = 1e-3  # force ratio with a finite logarithm
_FINGER_SPREAD = 0.2  # relative difference of the friction of fingers on one object
_SURE = 2.0  # standard deviations by which a force ratio must be certain
_MAX_DEVIATION = 3.0  # standard deviations; a slip that differs more means a new surface
_SMALLEST_MU, _LARGEST_MU = 0.1, 1.5  # limits of the estimate
_SMOOTHING = 0.02  # s, time constant of the forces of a contact that sticks


class FrictionConfig(Config):
    """Parameters of the friction estimate."""

    prior: float = param(0.4, "friction assumed before any slip or stick", live=True, gt=0.0)
    spread: float = param(
        0.5, "standard deviation of ln mu over everyday objects", live=True, gt=0.0
    )
    explore: float = param(
        0.05,
        "growth rate of an estimate as uncertain as the prior; others grow in proportion to their "
        "variance, up to one deviation above the prior, so that a firm grasp relaxes",
        unit="1/s",
        live=True,
        ge=0.0,
    )
    forget: float = param(
        300.0, "time until an estimate is as uncertain as the prior", unit="s", live=True, gt=0.0
    )


_MEMORY = np.dtype(
    [
        ("mean", np.float64),  # of ln mu
        ("variance", np.float64),
        ("prior", np.float64, 2),  # mean and variance at the start of the present slip
        ("quiet_for", np.float64),  # since any contact slipped; the same for all
        ("slid", np.bool_),  # whether this contact slipped then
        ("samples", np.int64),  # of its slip
        ("sum", np.float64, 5),  # of n, t, n n, t t and n t, their normal and tangential forces
        ("force", np.float64, 3),  # mean while it sticks, palm axes; NaN: none yet
        ("scatter", np.float64),  # of it per axis
        ("touched_for", np.float64),
        ("since", np.float64),  # the last new sample, s
    ],
    align=True,
)


class FrictionEstimator:
    """Estimates a Gaussian of ln mu for each contact.

    - It starts as the prior. Its variance grows back to that of the prior.
    - The mean grows in proportion to the variance, up to one standard deviation above the prior, so
      that a firm grasp relaxes, including after a false alarm.
    - A contact that slips measures ln(|f_t| / f_n) from its samples since the detector's sum left
      zero, Page's estimate of the start. The error follows from their scatter.
    - Other contacts use the same measurement, with the variance between fingers. The measurements
      of a slip are multiplied, in any order.
    - A contact that sticks has a mu above its force ratio, which bounds its mean from below.
    """

    def __init__(self, config: FrictionConfig, contacts: int) -> None:
        """Start k contacts from the prior."""
        self.memory: Rows = np.zeros(contacts, _MEMORY)
        self.configure(config)
        self.reset()

    def configure(self, config: FrictionConfig) -> None:
        """Change the parameters; the estimates stay."""
        self._config, self._row = config, row_of(config)

    def reset(self) -> None:
        """Go back to the prior."""
        self.memory[:] = np.zeros((), _MEMORY)
        self.memory["mean"] = math.log(self._config.prior)
        self.memory["variance"] = self._config.spread**2
        self.memory["quiet_for"] = np.inf
        self.memory["force"] = np.nan

    @property
    def estimate(self) -> Array:
        """The friction mu of each contact, shape (k,)."""
        mu = np.exp(self.memory["mean"])
        return np.asarray(np.minimum(np.maximum(mu, _SMALLEST_MU), _LARGEST_MU))

    def step(
        self,
        forces: Array,
        normals: Array,
        state: NDArray[np.int64],
        suspected: NDArray[np.bool_],
        agrees: NDArray[np.bool_],
        fresh: NDArray[np.bool_],
        dt: float,
    ) -> None:
        """Learn from a tick.

        `state`, `suspected` and `agrees`, each of shape (k,), are the detector's `ContactState`,
        whether it has evidence for slip, and whether the newest samples show slip; others do not
        measure friction. For the rest see `SlipDetector.step`.
        """
        _learn(self.memory, self._row, forces, normals, state, suspected, agrees, fresh, dt)


@compiled
def _learn(
    memory: Rows,
    config: Rows,
    forces: Array,
    normals: Array,
    state: NDArray[np.int64],
    suspected: NDArray[np.bool_],
    agrees: NDArray[np.bool_],
    fresh: NDArray[np.bool_],
    dt: float,
) -> None:
    """Update the estimates; see `FrictionEstimator.step`."""
    c, slips, was_quiet = config[0], False, memory[0]["quiet_for"] > _AFTERSHOCKS
    for i in range(len(memory)):
        m = memory[i]
        slips = slips or state[i] == ContactState.SLIP
        m["since"] += min(dt, LONGEST)
        if was_quiet and not suspected[i]:
            m["samples"] = 0
        if state[i] == ContactState.UNKNOWN:
            m["force"][:] = np.nan
        elif fresh[i]:
            normal = dot(forces[i], normals[i])
            if agrees[i] and m["samples"] < _SAMPLES:
                _add_sample(m, forces[i], normal)
            if state[i] == ContactState.STICK:
                _bound(m, forces[i], normals[i])
            else:
                m["force"][:] = np.nan
            m["since"] = 0.0
    for i in range(len(memory)):
        m = memory[i]
        if slips and was_quiet:
            m["prior"][0], m["prior"][1] = m["mean"], m["variance"]
        m["slid"] = state[i] == ContactState.SLIP or (m["slid"] and not was_quiet)
        m["quiet_for"] = 0.0 if slips else m["quiet_for"] + dt
        largest = c["spread"] ** 2
        if state[i] == ContactState.STICK:
            step = c["explore"] * m["variance"] / largest * min(dt, LONGEST)
            explored = min(m["mean"] + step, math.log(c["prior"]) + c["spread"])
            m["mean"] = max(m["mean"], explored)
        m["variance"] = min(m["variance"] + largest * dt / c["forget"], largest)
    if slips:
        _combine(memory)


@compiled
def _add_sample(m: Row, force: Array, normal: float) -> None:
    """Add a sample of a contact that may slide."""
    if m["samples"] == 0:
        m["sum"][:] = 0.0
    tangential = math.sqrt(max(0.0, dot(force, force) - normal * normal))
    m["samples"] += 1
    m["sum"][0] += normal
    m["sum"][1] += tangential
    m["sum"][2] += normal * normal
    m["sum"][3] += tangential * tangential
    m["sum"][4] += normal * tangential


@compiled
def _measured(m: Row) -> tuple[float, float]:
    """Return ln(|f_t| / f_n) of a slip and its variance, which is infinite without samples."""
    n = m["samples"]
    normal, tangential, normals, tangentials, products = m["sum"]
    if not m["slid"] or n < 2 or normal <= 0.0:
        return 0.0, math.inf
    ratio = max(tangential / normal, _SMALLEST)
    # For a force that moves along its cone only the distance to the cone is error.
    squares = max(0.0, tangentials - 2.0 * ratio * products + ratio * ratio * normals)
    return math.log(ratio), _EXACT**2 + squares / ((n - 1) * n) * (n / (ratio * normal)) ** 2


@compiled
def _combine(memory: Rows) -> None:
    """Multiply the Gaussians before a slip by its measurements."""
    for i in range(len(memory)):
        m = memory[i]
        before, variance = m["prior"][0], m["prior"][1]
        weight, total = 0.0, 0.0
        for j in range(len(memory)):
            ratio, error = _measured(memory[j])
            error += 0.0 if j == i else _FINGER_SPREAD**2
            if error < math.inf:
                weight += 1.0 / error
                total += ratio / error
                variance = max(variance, ((ratio - before) / _MAX_DEVIATION) ** 2 - error)
        weight, total = weight + 1.0 / variance, total + before / variance
        mean = min(max(total / weight, math.log(_SMALLEST_MU)), math.log(_LARGEST_MU))
        m["mean"], m["variance"] = mean, 1.0 / weight


@compiled
def _bound(m: Row, force: Array, n: Array) -> None:
    """Raise the mean to a force ratio at which this contact certainly sticks."""
    mean = m["force"]
    if math.isnan(mean[0]):
        mean[:] = force
        m["scatter"] = m["touched_for"] = 0.0
        return
    fraction = -math.expm1(-m["since"] / _SMOOTHING)
    off = force - mean
    mean[:] += fraction * off
    m["scatter"] += fraction * (dot(off, off) / 3.0 - m["scatter"])
    m["touched_for"] += m["since"]
    if m["touched_for"] < 3.0 * _SMOOTHING:  # too early for the scatter
        return
    normal, doubt = dot(mean, n), _SURE * math.sqrt(m["scatter"] * fraction)
    tangential = math.sqrt(max(0.0, dot(mean, mean) - normal * normal)) - doubt
    if normal > 0.0 and tangential > 0.0:
        m["mean"] = max(m["mean"], math.log(min(tangential / (normal + doubt), _LARGEST_MU)))
