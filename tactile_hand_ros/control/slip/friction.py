# SPDX-License-Identifier: Apache-2.0
"""The friction of a contact, learned from its slips and sticks only."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Row, Rows, compiled, row_of
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.slip.detector import ContactState

Array = NDArray[np.float64]

_SAMPLES = 4  # that are averaged against noise and vibration
_READINGS = 10  # of a slip that count; later the grasp force may long have caught it
_LARGEST = 3  # of them that are averaged
_EXACT = 1e-4  # variance below which no force ratio is known
_AFTERSHOCKS = 0.05  # s in which further alarms belong to the same slip
_SURE = 2.0  # standard deviations by which a force ratio must be proven
_INERTIA = 2.0  # slips that a well known friction weighs as much as
_LONGEST = 0.02  # s that a pause counts for at most: nothing is known of it
_AGREE = 0.15  # relative difference up to which two slips show the same friction


class FrictionConfig(Config):
    """Parameters of the friction estimate."""

    prior: float = param(0.4, "friction assumed before anything is known", live=True, gt=0.0)
    least: float = param(0.1, "friction is never taken for lower", live=True, gt=0.0)
    most: float = param(1.5, "friction is never taken for higher", live=True, gt=0.0)
    explore: float = param(
        0.05,
        "growth of an estimate that no slip has bounded yet, so that the grasp force is lowered "
        "until something slips a little",
        unit="1/s",
        live=True,
        ge=0.0,
    )
    forget: float = param(
        0.002, "growth of an estimate that slips have bounded", unit="1/s", live=True, ge=0.0
    )
    smoothing: float = param(
        0.02, "time constant of the forces of a contact that sticks", unit="s", live=True, gt=0.0
    )
    trust: float = param(
        0.05, "uncertainty of a slip's force ratio at which it counts half", live=True, gt=0.0
    )


_MEMORY = np.dtype(
    [
        ("estimate", np.float64),  # mu
        ("confidence", np.float64),
        ("caution", np.float64),  # confidence of the best known contact with a lower estimate
        ("mean", np.float64, 3),  # force while it sticks; NaN: none yet
        ("variance", np.float64),  # of it
        ("touched_for", np.float64),
        ("since", np.float64),  # the last new sample, s
        ("slid", np.float64, (_SAMPLES, 3)),  # the newest forces of a slip, oldest first
        ("samples", np.int64),  # how many of them are there
        ("ratios", np.float64, _READINGS),  # |f_t| / f_n of means of so many forces
        ("readings", np.int64),  # how many of them are there
        ("precision", np.float64),  # of the ratios together
        ("slips", np.bool_),  # whether a slip continues, or its aftershocks
        ("before", np.float64, 2),  # estimate and confidence when it began
        ("quiet_for", np.float64),
    ],
    align=True,
)


class FrictionEstimator:
    """Bounds mu of each contact: sticking at a force ratio proves mu above it, slipping shows mu.

    A slip is read from its own samples only: those since the detector's sum left zero, which is
    Page's estimate of when it began. A contact that slides shows mu, one that the grasp force has
    caught shows less, so that the largest few ratios count. How much they count depends on how well
    they show: a contact that is barely pressed shows next to nothing. An estimate grows the more
    slowly, the better slips have shown it, so that a false alarm is soon forgotten and a surface
    that slipped twice at the same ratio is not.
    """

    def __init__(self, config: FrictionConfig, contacts: int) -> None:
        """Start from the prior for a number k of contacts."""
        self._memory: Rows = np.zeros(contacts, _MEMORY)
        self.configure(config)
        self.reset()
        self.share()  # changes nothing, and the first slip need not wait until it is loaded

    def configure(self, config: FrictionConfig) -> None:
        """Take other parameters; what was learned stays."""
        self._prior = config.prior
        self._config = row_of(config)

    def reset(self) -> None:
        """Forget what was learned."""
        self._memory[:] = np.zeros((), _MEMORY)
        self._memory["estimate"] = self._prior
        self._memory["mean"] = np.nan

    @property
    def memory(self) -> Rows:
        """All that is known of the contacts, for `restore`."""
        return self._memory.copy()

    def restore(self, memory: Rows) -> None:
        """Go back to a `memory` from before."""
        self._memory[:] = memory

    @property
    def estimate(self) -> Array:
        """The friction mu of each contact, shape (k,)."""
        return self._memory["estimate"].copy()

    @property
    def confidence(self) -> Array:
        """How well slips have shown it, 0 to 1, shape (k,)."""
        return self._memory["confidence"].copy()

    def step(
        self,
        forces: Array,
        state: NDArray[np.int64],
        evidence: Array,
        dt: float,
        agrees: NDArray[np.bool_],
        fresh: NDArray[np.bool_],
    ) -> Array:
        """Return the estimates after a tick, shape (k,).

        Args:
            forces: Measured forces in contact frames (x, n, z), shape (k, 3), N; NaN where there is
                none.
            state: What the detector says of the contacts, `ContactState`, shape (k,).
            evidence: Its evidence for slip; zero: nothing slips; shape (k,).
            dt: Time since the last tick, s.
            agrees: Whether the newest samples show slip; one of a contact that the grasp force has
                caught shows nothing of friction; shape (k,).
            fresh: Whether the forces are new samples; from one that is repeated nothing is learned
                twice; shape (k,).
        """
        _learn(self._memory, self._config, forces, state, evidence, dt, agrees, fresh)
        return self.estimate

    def share(self) -> None:
        """Lower estimates to what better known contacts with the same object have shown.

        A finger that barely presses cannot learn from its own slips. Never the other way round:
        too low an estimate costs force, too high a one the object. Nor does an estimate grow faster
        than a lower one that is better known.
        """
        _share(self._memory)


@compiled
def _learn(
    memory: Rows,
    config: Rows,
    forces: Array,
    state: NDArray[np.int64],
    evidence: Array,
    dt: float,
    agrees: NDArray[np.bool_],
    fresh: NDArray[np.bool_],
) -> None:
    """Let each contact of a memory learn from its force."""
    c = config[0]
    for i in range(len(memory)):
        m, force = memory[i], forces[i]
        if state[i] == ContactState.UNKNOWN or not math.isfinite(force[0] + force[1] + force[2]):
            _forget_forces(m)
            continue
        _follow(m, force, evidence[i], agrees[i] and fresh[i])
        m["since"] += dt
        if state[i] == ContactState.SLIP:
            _slip(m, c["trust"])
        else:
            _stick(m, c, min(dt, _LONGEST))
            if fresh[i]:
                m["estimate"] = max(m["estimate"], _proven(m, force, c["smoothing"]))
        if fresh[i]:
            m["since"] = 0.0
        m["estimate"] = min(max(m["estimate"], c["least"]), c["most"])


@compiled
def _forget_forces(m: Row) -> None:
    mean = m["mean"]
    mean[0] = mean[1] = mean[2] = np.nan
    m["samples"] = m["readings"] = 0
    m["precision"] = 0.0
    m["slips"] = False


@compiled
def _follow(m: Row, force: Array, evidence: float, agrees: bool) -> None:
    """Read the force ratio since the evidence for a slip began."""
    if evidence <= 0.0:
        m["samples"] = 0
        if not m["slips"]:
            m["readings"] = 0
            m["precision"] = 0.0
        return
    if not agrees:
        return
    slid = m["slid"]
    if m["samples"] == _SAMPLES:
        slid[:-1] = slid[1:].copy()
        m["samples"] -= 1
    slid[m["samples"]] = force
    m["samples"] += 1
    if m["samples"] == _SAMPLES:
        _read(m)


@compiled
def _read(m: Row) -> None:
    """Take the force ratio of some successive forces."""
    slid, n = m["slid"], _SAMPLES
    x, normal, z = 0.0, 0.0, 0.0
    for i in range(n):
        x, normal, z = x + slid[i, 0], normal + slid[i, 1], z + slid[i, 2]
    x, normal, z = x / n, normal / n, z / n
    if normal <= 0.0 or m["readings"] == _READINGS:
        return
    squares = 0.0
    for i in range(n):
        squares += (slid[i, 0] - x) ** 2 + (slid[i, 1] - normal) ** 2 + (slid[i, 2] - z) ** 2
    variance = squares / (3.0 * n * (n - 1)) / normal**2 + _EXACT
    m["ratios"][m["readings"]] = math.sqrt(x * x + z * z) / normal
    m["readings"] += 1
    # Each force is part of n means, which are therefore not independent.
    m["precision"] += 1.0 / (n * variance)


@compiled
def _reading(m: Row, trust: float) -> tuple[float, float]:
    """Return the mean of the largest few ratios of a slip and how much it counts, 0 to 1.

    It counts half where it is as uncertain as `trust`; without ratios both are 0.
    """
    known = min(m["readings"], _LARGEST)
    ordered, total = np.sort(m["ratios"][: m["readings"]]), 0.0
    for i in range(len(ordered) - known, len(ordered)):
        total += ordered[i]
    gain = trust * trust * m["precision"]
    return total / max(known, 1), gain / (1.0 + gain)


@compiled
def _slip(m: Row, trust: float) -> None:
    """Take the force ratio of a slip, as far as it can be trusted."""
    m["quiet_for"] = 0.0
    before = m["before"]
    if not m["slips"]:
        m["slips"] = True
        before[0], before[1] = m["estimate"], m["confidence"]
    estimate, confidence = before[0], before[1]
    ratio, weight = _reading(m, trust)
    # What slips have shown before weighs against a single contrary one, maybe a false alarm.
    known, shown = _information(confidence), _information(weight)
    gain = shown / (1.0 + _INERTIA * known + shown)
    m["estimate"] = estimate + gain * (ratio - estimate)
    agrees = abs(ratio - estimate) < _AGREE * estimate
    # A weak contrary reading shakes what is known a little, a strong one replaces it.
    shaken = max(gain, confidence * (1.0 - weight))
    m["confidence"] = 1.0 - (1.0 - confidence) * (1.0 - weight) if agrees else shaken
    m["mean"][0] = np.nan


@compiled
def _stick(m: Row, c: Row, dt: float) -> None:
    """Let the estimate grow with time, the more slowly the better it is known."""
    m["quiet_for"] += dt
    if m["quiet_for"] > _AFTERSHOCKS:
        m["slips"] = False
    growth = c["explore"] + max(m["confidence"], m["caution"]) * (c["forget"] - c["explore"])
    m["estimate"] *= 1.0 + growth * dt


@compiled
def _proven(m: Row, force: Array, time: float) -> float:
    """Return a force ratio that this contact has surely been sticking at."""
    mean = m["mean"]
    if math.isnan(mean[0]):
        mean[0], mean[1], mean[2] = force[0], force[1], force[2]
        m["variance"] = m["touched_for"] = 0.0
        return 0.0
    fraction, squares = 1.0 - math.exp(-m["since"] / time), 0.0
    for axis in range(3):
        off = force[axis] - mean[axis]
        mean[axis] += fraction * off
        squares += off * off
    m["variance"] += fraction * (squares / 3.0 - m["variance"])
    m["touched_for"] += min(m["since"], _LONGEST)
    if m["touched_for"] < 3.0 * time:  # too early for the variance to be known
        return 0.0
    x, n, z = mean
    doubt = _SURE * math.sqrt(m["variance"] * fraction)
    return max(0.0, math.sqrt(x * x + z * z) - doubt) / (n + doubt) if n > 0.0 else 0.0


@compiled
def _information(confidence: float) -> float:
    """Return how much information, against none, makes one so confident."""
    return confidence / max(1.0 - confidence, 1e-9)


@compiled
def _share(memory: Rows) -> None:
    """Let each contact of a memory learn what the others have shown."""
    for i in range(len(memory)):
        m = memory[i]
        m["caution"] = 0.0
        for j in range(len(memory)):
            if memory[j]["estimate"] < m["estimate"]:
                m["caution"] = max(m["caution"], memory[j]["confidence"])
        for j in range(len(memory)):
            other = memory[j]
            trust = 0.5 * other["confidence"]
            if other["estimate"] < m["estimate"] and trust > m["confidence"]:
                fraction = other["confidence"] * (1.0 - m["confidence"])
                m["estimate"] += fraction * (other["estimate"] - m["estimate"])
                m["confidence"] = trust
