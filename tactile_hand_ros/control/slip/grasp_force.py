# SPDX-License-Identifier: Apache-2.0
"""The required grasp force of an object, and the reflex when a contact slips or is lost."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, Rows, compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.loads import ReserveConfig, Split, required_grasp_force, shift
from tactile_hand_ros.control.slip.detector import LONGEST
from tactile_hand_ros.rotations import dot

_LOAD_TIME = 0.005  # s, time constant of the measured load: a few samples of a fast skin
_LEAD = 0.01  # s of extrapolation of a load: about the delay of skin, tick and fingers
_SHAPE_TIME = 0.03  # s, time constant of the measured f*, which only the hand changes
_MEMORY_TIME = 5.0  # s, time constant of the memory of loads
_RESERVE_TIME = 0.05  # s in which the reserve of a new grasp rises, while f* takes its shape

_MEMORY = np.dtype(
    [
        ("load", np.float64, 3),  # smoothed, palm axes; NaN: none yet
        ("trend", np.float64, 3),  # its rate
        ("internal", np.float64, 3),  # smoothed internal force, palm axes
        ("largest", np.float64),  # load of the recent past, N
        ("held_for", np.float64),  # time of this contact in the grasp, s
    ]
)


class RequiredGraspForce:
    """Computes the minimum grasp force that holds, from the load and the measured f*.

    The load may change at any time, so its filter is fast. The filter of the shape f* is slow: only
    the hand changes f*, and noise in a shape near the edge of its cone would raise the result
    without bound. The reserve is in proportion to the weight of a finger and to recent loads. At a
    new contact it rises while f* adapts; the rest applies from the first sample.

    Attributes:
        config: Its parameters, which may change at any time.
        reserve: Additional load in any direction for each contact, shape (k,), N.
    """

    def __init__(self, config: ReserveConfig, contacts: int, finger_weight: float) -> None:
        """Start without a grasp of k contacts; the weight of a finger is in N."""
        self.config, self._weight = config, finger_weight
        self._memory: Rows = np.zeros(contacts, _MEMORY)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._memory["largest"] = 0.0
        self.reserve = self._reserve()
        self.lose()

    def lose(self) -> None:
        """Forget load and shape; the largest recent load stays."""
        self._memory["load"] = np.nan

    @property
    def internal(self) -> Array:
        """The internal force of the last grasp, smoothed, palm axes, shape (k, 3), N."""
        return self._memory["internal"].copy()

    @property
    def load(self) -> Array:
        """The load of the contacts, smoothed, palm axes, shape (k, 3), N; NaN: unknown."""
        return self._memory["load"].copy()

    def step(
        self,
        parts: Split,
        normals: Array,
        friction: Array,
        usable: Array,
        dt: float,
        *,
        grasped: bool = True,
    ) -> tuple[float, float]:
        """Return the minimum k_f that keeps each contact inside its cone, without and with reserve.

        The first is infinite if no grasp force of this shape holds. The second leaves out contacts
        for which no grasp force of this shape gives the reserve.

        Args:
            parts: Measured forces as load and internal force.
            normals: Contact normals into the object, palm axes, shape (k, 3); NaN: not grasped.
            friction: Learned mu of each contact, shape (k,); for the reserve.
            usable: The same less its margin, shape (k,); for measured loads. A low mu and a sudden
                load rarely coincide.
            dt: Time since the last tick, s.
            grasped: Whether the grasp is complete; otherwise only the load is updated.
        """
        memory = self._memory
        _remember(memory, normals, parts.load, dt)
        self.reserve = self._reserve()
        _follow(memory, normals, parts.load, parts.internal, dt, grasped)
        return _needed(memory, normals, friction, usable, self.reserve, dt)

    def _reserve(self) -> Array:
        c, largest = self.config, self._memory["largest"]
        return np.maximum(c.floor * self._weight / len(largest), c.fraction * largest)


@compiled
def _remember(memory: Rows, normals: Array, loads: Array, dt: float) -> None:
    """Update the largest loads and the time of each contact; forget loads if others touch."""
    changed, keep = False, math.exp(-dt / _MEMORY_TIME)
    for i in range(len(memory)):
        m, misses = memory[i], math.isnan(normals[i, 0])
        missed = math.isnan(m["load"][0])
        changed |= missed != misses
        if missed and not misses:
            m["held_for"] = 0.0
        m["held_for"] += dt
        m["largest"] = np.maximum(keep * m["largest"], math.sqrt(dot(loads[i], loads[i])))
    if changed:
        memory["load"][:] = np.nan  # another split


@compiled
def _follow(
    memory: Rows, normals: Array, loads: Array, internal: Array, dt: float, grasped: bool
) -> None:
    """Smooth load, trend and, for a complete grasp, internal force of each contact."""
    fraction = -math.expm1(-dt / _LOAD_TIME)
    slow = -math.expm1(-dt / _SHAPE_TIME) if grasped else 0.0
    for i in range(len(memory)):
        m = memory[i]
        if math.isnan(normals[i, 0]):  # does not touch
            m["load"][:], m["internal"][:] = np.nan, 0.0
            continue
        if dt == 0.0 or math.isnan(m["load"][0]):
            m["load"][:], m["trend"][:], m["internal"][:] = loads[i], 0.0, internal[i]
            continue
        m["internal"][:] += slow * (internal[i] - m["internal"])
        moved = fraction * (loads[i] - m["load"])
        m["load"][:] += moved
        m["trend"][:] += fraction * (moved / dt - m["trend"])


@compiled
def _needed(
    memory: Rows, normals: Array, friction: Array, usable: Array, reserve: Array, dt: float
) -> tuple[float, float]:
    """Return the largest need of any contact, without and with reserve, N."""
    needed, ready, total = 0.0, 0.0, 0.0
    for i in range(len(memory)):
        if not math.isnan(memory[i]["load"][0]):
            total += dot(memory[i]["internal"], normals[i])
    # A load that grows at a constant rate is ahead of its low-pass by the lag.
    dt = min(dt, LONGEST)
    ahead = _LEAD + (dt / math.expm1(dt / _LOAD_TIME) if dt > 0.0 else _LOAD_TIME)
    for i in range(len(memory)):
        m = memory[i]
        if math.isnan(m["load"][0]):
            continue
        shape, load = m["internal"] / total, m["load"] + ahead * m["trend"]
        alone = required_grasp_force(load, shape, normals[i], usable[i])
        lost = shift(min(1.0, m["held_for"] / _RESERVE_TIME) * reserve[i], friction[i])
        more = required_grasp_force(load, shape, normals[i], friction[i], lost)
        needed = max(needed, alone)
        ready = max(ready, alone, more if math.isfinite(more) else 0.0)
    return needed, ready


_DOUBLING = 0.01  # s in which the grasp force doubles while something slips
_CALM = 0.05  # s without slip, after which the next one starts from the present grasp force


class SlipResponseConfig(Config):
    """Parameters of the reflex against slip."""

    margin: float = param(
        0.15, "margin below the learned friction, as a fraction", live=True, ge=0.0
    )
    rise_rate: float = param(4000.0, "fastest rise of grasp force", unit="N/s", live=True, gt=0.0)
    first_rise: float = param(
        2.0, "factor of the grasp force when a slip starts or a contact is lost", live=True, ge=1.0
    )
    release_rate: float = param(
        1.0, "minimum fall of the grasp force to the required one", unit="N/s", live=True, gt=0.0
    )
    release_time: float = param(0.5, "time constant of a large excess", unit="s", live=True, gt=0.0)


class SlipResponse:
    """Follows the required grasp force, and exceeds it while that is unknown.

    A sliding contact transmits only its friction limit, and a grasp that has lost a contact shows
    only a part of its load. The force is too low by an unknown amount, so it doubles immediately,
    and again in every 10 ms of slip.

    Attributes:
        grasp_force: The requested k_f, N.
    """

    def __init__(self, config: SlipResponseConfig, grasp_force: float) -> None:
        """Start at a k_f in N."""
        self.config = config
        self.start(grasp_force)

    def start(self, grasp_force: float) -> None:
        """Continue from a k_f in N without a grasp."""
        self.grasp_force = self._settled = grasp_force
        self._calm_for = self._grown = 0.0
        self._whole = False

    def step(
        self,
        needed: float,
        slips: bool,
        slides: bool,
        touching: NDArray[np.bool_],
        rejected: NDArray[np.bool_],
        limit: float,
        dt: float,
    ) -> float:
        """Return the grasp force after a tick, N.

        Args:
            needed: Required grasp force, N; not finite while unknown.
            slips: Whether a contact slips.
            slides: Whether its newest samples are evidence for slip, too.
            touching: Which contacts touch or are not part of the grasp, shape (k,).
            rejected: Which contacts may be lost or not, as their touch is rejected, shape (k,).
            limit: Largest grasp force, N.
            dt: Time since the last tick, s.
        """
        c, dt = self.config, min(dt, LONGEST)  # of a longer pause, nothing is known
        whole, some = bool(touching.all()), bool(touching.any())
        lost = self._whole and not (touching | rejected).all()
        self._whole = whole or (self._whole and some)
        goal = needed if math.isfinite(needed) else self.grasp_force
        if not whole:
            goal = max(goal, self.grasp_force)  # the rest shows only a part of the need
        goal = max(goal, self._reflex(slips, slides, whole, lost, limit, dt))
        if not some:  # the object is gone
            goal = self._settled
        falls = max(c.release_rate, (self.grasp_force - goal) / c.release_time)
        low, high = self.grasp_force - falls * dt, self.grasp_force + c.rise_rate * dt
        self.grasp_force = min(max(goal, low), high, limit)
        return self.grasp_force

    def _reflex(
        self, slips: bool, slides: bool, whole: bool, lost: bool, limit: float, dt: float
    ) -> float:
        """Return the grasp force after a slip or a lost contact, N; 0 without either."""
        if not slips and not lost:
            self._calm_for += dt
            if self._calm_for > _CALM and whole:
                self._settled = self.grasp_force
            self._grown = 0.0
            return 0.0
        c = self.config
        self._calm_for = 0.0
        self._grown = max(self._grown, c.first_rise * self._settled)
        if slides:
            growth = math.exp(dt / _DOUBLING * math.log(2.0))
            self._grown = min(growth * max(self._grown, self.grasp_force), limit)
        return self._grown
