# SPDX-License-Identifier: Apache-2.0
"""The grasp force that an object needs, and how it rises when a contact slips or is lost."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Rows, compiled
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.loads import ReserveConfig, Split, required_grasp_force, shift
from tactile_hand_ros.rotations import dot

Array = NDArray[np.float64]

_LOAD_TIME = 0.005  # s, time constant of the measured load: a few samples of a fast skin
_LEAD = 0.01  # s that a changing load is foreseen: about what skin, tick and fingers need
_SHAPE_TIME = 0.03  # s, time constant of f* as measured; only the hand itself changes it
_MEMORY_TIME = 5.0  # s, time constant with which recent loads are forgotten
_RESERVE_TIME = 0.05  # s over which the reserve of a new grasp rises; f* takes its shape meanwhile

_MEMORY = np.dtype(
    [
        ("load", np.float64, 3),  # smoothed, palm axes; NaN: none yet
        ("trend", np.float64, 3),  # its rate
        ("internal", np.float64, 3),  # smoothed internal force, palm axes
        ("largest", np.float64),  # load of the recent past, N
        ("held_for", np.float64),  # since this contact has been part of the grasp, s
    ]
)


class RequiredGraspForce:
    """Follows load and f* in palm axes, and computes the minimum grasp force that holds.

    The load may change at any time and is followed fast. The shape is f*, which the hand itself
    changes slowly: a finger that presses with a few tenths of a newton shows it only through noise,
    and the need of a shape near the edge of its cone grows without bound. It is the smoothed
    internal force per unit of itself, so that a sample counts for as much as it shows.

    What may come on top is in proportion to the weight of a finger and to the loads of the recent
    past. What a new grasp needs apart from that reserve is known from the first sample on, and
    asked for immediately. The reserve of a contact rises while f* takes the shape that is made for
    it and the shape is measured.

    Attributes:
        reserve: Load in any direction that may come on top at each contact, shape (k,), N.
    """

    def __init__(self, config: ReserveConfig, contacts: int, finger_weight: float) -> None:
        """Start without a grasp of k contacts by fingers with a weight in N."""
        self._memory: Rows = np.zeros(contacts, _MEMORY)
        self._weight = finger_weight
        self.configure(config)
        self.reset()

    def configure(self, config: ReserveConfig) -> None:
        """Take another reserve; load and shape stay."""
        self._config = config

    def reset(self) -> None:
        """Forget everything."""
        self._memory["largest"] = 0.0
        self.reserve = self._reserve()
        self.lose()

    def lose(self) -> None:
        """Forget load and shape; what the recent past has shown stays."""
        self._memory["load"] = np.nan

    @property
    def internal(self) -> Array:
        """The internal force of the last grasp, smoothed, palm axes, shape (k, 3), N."""
        return self._memory["internal"].copy()

    @property
    def load(self) -> Array:
        """The load that the contacts carry, smoothed, palm axes, shape (k, 3), N; NaN: unknown."""
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
        """Return the minimum k_f that keeps each contact inside its cone, and with a reserve, N.

        Args:
            parts: Measured forces as load and internal force.
            normals: Contact normals into the object, palm axes, shape (k, 3); NaN: not grasped.
            friction: mu of each contact as learned, shape (k,); for the reserve.
            usable: The same less its margin, shape (k,); for the loads that are measured, since
                a smaller mu and a sudden load rarely come together.
            dt: Time since the last tick, s.
            grasped: Whether the contacts are there; else only the load is followed.

        Returns:
            The first is infinite when no grasp force of the present shape can hold. The second is
            the first for a contact that no grasp force of this shape gives the reserve.
        """
        memory, size = self._memory, np.sqrt((parts.load * parts.load).sum(axis=1))
        missed, misses = np.isnan(memory["load"][:, 0]), np.isnan(normals[:, 0])
        memory["held_for"][missed & ~misses] = 0.0
        if (missed != misses).any():
            memory["load"] = np.nan  # other fingers touch: another split
        faded = math.exp(-dt / _MEMORY_TIME) * memory["largest"]
        memory["largest"] = np.maximum(faded, size)
        self.reserve = self._reserve()
        memory["held_for"] += dt
        radii = np.minimum(1.0, memory["held_for"] / _RESERVE_TIME) * self.reserve
        _follow(memory, normals, parts.load, parts.internal, dt, grasped)
        return _needed(memory, normals, friction, usable, radii, dt)

    def _reserve(self) -> Array:
        c, largest = self._config, self._memory["largest"]
        return np.maximum(c.floor * self._weight / len(largest), c.fraction * largest)


@compiled
def _follow(
    memory: Rows, normals: Array, loads: Array, internal: Array, dt: float, grasped: bool
) -> None:
    """Smooth load, trend and, where all are there, internal force of each contact."""
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
    memory: Rows, normals: Array, friction: Array, usable: Array, radii: Array, dt: float
) -> tuple[float, float]:
    """Return what the neediest contact of a memory needs, and with a reserve, N."""
    needed, ready, total = 0.0, 0.0, 0.0
    for i in range(len(memory)):
        if not math.isnan(memory[i]["load"][0]):
            total += dot(memory[i]["internal"], normals[i])
    # A load that grows at a constant rate is ahead of its low-pass by the lag.
    ahead = _LEAD + (dt / math.expm1(dt / _LOAD_TIME) if dt > 0.0 else _LOAD_TIME)
    for i in range(len(memory)):
        m = memory[i]
        if math.isnan(m["load"][0]):
            continue
        shape, load = m["internal"] / total, m["load"] + ahead * m["trend"]
        alone = required_grasp_force(load, shape, normals[i], usable[i])
        lost = shift(radii[i], friction[i])
        more = required_grasp_force(load, shape, normals[i], friction[i], lost)
        needed = max(needed, alone)
        ready = max(ready, alone, more if math.isfinite(more) else 0.0)
    return needed, ready


_LONGEST = 0.02  # s that a pause counts for at most: nothing is known of it
_DOUBLING = 0.01  # s in which the grasp force doubles while something slips
_CALM = 0.05  # s without slip after which the next is a new one, met from the present grasp force


class SlipResponseConfig(Config):
    """Parameters of the reflex that keeps an object from slipping."""

    margin: float = param(
        0.15, "fraction by which the grasp force exceeds what the friction needs", live=True, ge=0.0
    )
    rise_rate: float = param(
        4000.0, "fastest rise of the grasp force", unit="N/s", live=True, gt=0.0
    )
    first_rise: float = param(
        2.0,
        "factor by which the grasp force rises when a slip begins or a contact is lost",
        live=True,
        ge=1.0,
    )
    release_rate: float = param(
        1.0, "minimum fall of the grasp force towards what is needed", unit="N/s", live=True, gt=0.0
    )
    release_time: float = param(
        0.5, "time constant with which a large excess falls", unit="s", live=True, gt=0.0
    )


class SlipResponse:
    """Follows the need, and goes beyond it while the need cannot be known.

    A contact that slides shows only what friction transmits, and a grasp that has lost a contact
    shows a part of its load: both show that the grasp force is too small, not by how much. The
    grasp force then doubles immediately, and again in every 10 ms in which the skin continues
    showing slip.

    Attributes:
        grasp_force: The k_f that it asks for, N.
    """

    def __init__(self, config: SlipResponseConfig, grasp_force: float) -> None:
        """Start at a grasp force in N."""
        self.config = config
        self.start(grasp_force)

    def start(self, grasp_force: float) -> None:
        """Continue from a grasp force in N, without a grasp that could be lost."""
        self.grasp_force = self._settled = grasp_force
        self._calm_for = self._grown = 0.0
        self._whole = False

    def step(
        self,
        needed: float,
        slips: bool,
        slides: bool,
        touching: NDArray[np.bool_],
        limit: float,
        dt: float,
    ) -> float:
        """Return the grasp force after a tick, N.

        Args:
            needed: Grasp force that load and friction ask for, N; not finite while unknown.
            slips: Whether a slip continues.
            slides: Whether the newest samples show it too.
            touching: Which contacts touch, or are not needed, shape (k,).
            limit: Largest grasp force, N.
            dt: Time since the last tick, s.
        """
        c = self.config
        touches = touching.tolist()
        whole, some = all(touches), any(touches)
        goal = needed if math.isfinite(needed) else self.grasp_force
        if not whole:
            goal = max(goal, self.grasp_force)  # what is left shows the need only in part
        goal = max(goal, self._reflex(slips, slides, whole, some, limit, dt))
        if not some:  # nothing is left that a grasp force could hold
            goal = self._settled
        falls = max(c.release_rate, (self.grasp_force - goal) / c.release_time)
        low, high = self.grasp_force - falls * dt, self.grasp_force + c.rise_rate * dt
        self.grasp_force = min(max(goal, low), high, limit)
        return self.grasp_force

    def _reflex(
        self, slips: bool, slides: bool, whole: bool, some: bool, limit: float, dt: float
    ) -> float:
        """Return the grasp force that a slip or a lost contact asks for, N; 0 without either."""
        lost = self._whole and not whole
        self._whole = whole or (lost and some)
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
            growth = math.exp(min(dt, _LONGEST) / _DOUBLING * math.log(2.0))
            self._grown = min(growth * max(self._grown, self.grasp_force), limit)
        return self._grown
