# SPDX-License-Identifier: Apache-2.0
"""The grasp force that an object needs, and how it rises when a contact slips or is lost."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Row, Rows, compiled, row_of
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.loads import (
    LoadMargin,
    LoadMarginConfig,
    Split,
    required_grasp_force,
    shift,
)
from tactile_hand_ros.rotations import dot

Array = NDArray[np.float64]


class RequiredGraspForceConfig(Config):
    """How load and shape of a grasp are followed."""

    smoothing: float = param(
        0.005, "time constant of the measured load", unit="s", live=True, gt=0.0
    )
    shape_smoothing: float = param(
        0.03,
        "time constant of f* as measured; only the hand itself changes it",
        unit="s",
        live=True,
        gt=0.0,
    )
    lead: float = param(
        0.01, "how far ahead a changing load is foreseen", unit="s", live=True, ge=0.0
    )
    reserve: LoadMarginConfig = LoadMarginConfig()
    reserve_time: float = param(
        0.05,
        "time over which the reserve of a new grasp rises from nothing",
        unit="s",
        live=True,
        ge=0.0,
        le=10.0,
    )


_MEMORY = np.dtype(
    [
        ("load", np.float64, 3),  # smoothed, palm axes; NaN: none yet
        ("trend", np.float64, 3),  # its rate
        ("internal", np.float64, 3),  # smoothed internal force, palm axes
    ]
)


class RequiredGraspForce:
    """Follows load and f* in palm axes, and computes the minimum grasp force that holds.

    The load may change at any time and is followed fast. The shape is f*, which the hand itself
    changes slowly: a finger that presses with a few tenths of a newton shows it only through noise,
    and the need of a shape near the edge of its cone grows without bound. It is the smoothed
    internal force per unit of itself, so that a sample counts for as much as it shows.

    What a new grasp needs apart from its reserve is known from the first sample on, and asked for
    immediately. The reserve rises over `reserve_time`: until f* has taken the shape that is
    made for it, `shape_time` of the optimizer, and that shape is measured, `shape_smoothing`, the
    grasp force that it asks for is that of a shape which is about to change.
    """

    def __init__(
        self, config: RequiredGraspForceConfig, contacts: int, finger_weight: float
    ) -> None:
        """Start without a grasp of k contacts by fingers with a weight in N."""
        self._memory: Rows = np.zeros(contacts, _MEMORY)
        self._reserve = LoadMargin(config.reserve, contacts, finger_weight)
        self.configure(config)
        self.reset()

    def configure(self, config: RequiredGraspForceConfig) -> None:
        """Take other parameters; load and shape stay."""
        self._config = row_of(config)
        self._reserve_time = config.reserve_time
        self._reserve.configure(config.reserve)

    def reset(self) -> None:
        """Forget everything."""
        self.lose()
        self._reserve.reset()

    def lose(self) -> None:
        """Forget load and shape; what the recent past has shown stays."""
        self._memory["load"] = np.nan
        self._held_for = 0.0

    def step(
        self, parts: Split, normals: Array, friction: Array, dt: float, margin: float = 0.0
    ) -> tuple[float, float]:
        """Return the minimum k_f that keeps each contact inside its cone, and with a reserve, N.

        Args:
            parts: Measured forces as load and internal force; the internal force must push.
            normals: Contact normals into the object, palm axes, shape (k, 3).
            friction: mu of each contact as learned, shape (k,).
            dt: Time since the last tick, s.
            margin: Fraction by which mu may be smaller than learned; for the loads that are
                measured, not for those of the reserve: both rarely come together.

        Returns:
            The first is infinite when no grasp force of the present shape can hold. The second is
            the first for a contact that no grasp force of this shape gives the reserve.
        """
        radii = self._reserve.step(parts.load, dt)
        self._held_for += dt
        if self._held_for < self._reserve_time:
            radii *= self._held_for / self._reserve_time
        usable = friction / (1.0 + margin)
        touch = parts.load, parts.internal, normals
        return _needed(self._memory, self._config, *touch, friction, usable, radii, dt)


@compiled
def _needed(
    memory: Rows,
    config: Rows,
    loads: Array,
    internal: Array,
    normals: Array,
    friction: Array,
    usable: Array,
    radii: Array,
    dt: float,
) -> tuple[float, float]:
    """Return what the neediest contact of a memory needs, and with a reserve, N."""
    c, needed, ready, total = config[0], 0.0, 0.0, 0.0
    for i in range(len(memory)):
        m = memory[i]
        if dt == 0.0 or math.isnan(m["load"][0]):
            m["load"][:], m["trend"][:], m["internal"][:] = loads[i], 0.0, internal[i]
        else:
            _follow(m, c, loads[i], internal[i], dt)
        total += dot(m["internal"], normals[i])
    for i in range(len(memory)):
        m = memory[i]
        shape = m["internal"] / total
        # A load that grows at a constant rate is ahead of its low-pass by the lag.
        lag = dt / math.expm1(dt / c["smoothing"]) if dt > 0.0 else c["smoothing"]
        load = m["load"] + (lag + c["lead"]) * m["trend"]
        alone = required_grasp_force(load, shape, normals[i], usable[i])
        lost = shift(radii[i], friction[i])
        more = required_grasp_force(load, shape, normals[i], friction[i], lost)
        needed = max(needed, alone)
        ready = max(ready, alone, more if math.isfinite(more) else 0.0)
    return needed, ready


@compiled
def _follow(m: Row, c: Row, load: Array, internal: Array, dt: float) -> None:
    """Smooth load, trend and internal force of a contact."""
    fraction, slow = -math.expm1(-dt / c["smoothing"]), -math.expm1(-dt / c["shape_smoothing"])
    m["internal"][:] += slow * (internal - m["internal"])
    moved = fraction * (load - m["load"])
    m["load"][:] += moved
    m["trend"][:] += fraction * (moved / dt - m["trend"])


_LONGEST = 0.02  # s that a pause counts for at most: nothing is known of it
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
    doubling_time: float = param(
        0.01,
        "time in which the grasp force doubles while something slips",
        unit="s",
        live=True,
        gt=0.0,
    )
    release_rate: float = param(
        1.0, "minimum fall of the grasp force towards what is needed", unit="N/s", live=True, gt=0.0
    )
    release_time: float = param(
        0.5, "time constant with which a large excess falls", unit="s", live=True, gt=0.0
    )
    need: RequiredGraspForceConfig = RequiredGraspForceConfig()


class SlipResponse:
    """Follows the need, and goes beyond it while the need cannot be known.

    A contact that slides shows only what friction transmits, and a grasp that has lost a contact
    has no need that could be computed: both show that the grasp force is too small, not by how
    much. The grasp force then doubles immediately, and again in every `doubling_time` in which the
    skin continues showing slip, or a contact that is left after another was lost is at the edge of
    its cone.

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
            slides: Whether the newest samples show it too; with a contact lost also whether one
                that is left carries all that its friction is trusted with.
            touching: Which contacts touch, shape (k,).
            limit: Largest grasp force, N.
            dt: Time since the last tick, s.
        """
        c = self.config
        touches = touching.tolist()
        whole, some = all(touches), any(touches)
        goal = needed if math.isfinite(needed) else self.grasp_force
        goal = max(goal, self._startled(slips, slides, whole, some, limit, dt))
        if not some:  # nothing is left that a grasp force could hold
            goal = self._settled
        falls = max(c.release_rate, (self.grasp_force - goal) / c.release_time)
        low, high = self.grasp_force - falls * dt, self.grasp_force + c.rise_rate * dt
        self.grasp_force = min(max(goal, low), high, limit)
        return self.grasp_force

    def _startled(
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
            growth = math.exp(min(dt, _LONGEST) / c.doubling_time * math.log(2.0))
            self._grown = min(growth * max(self._grown, self.grasp_force), limit)
        return self._grown
