# SPDX-License-Identifier: Apache-2.0
"""The grasp force k_f: what the user asks for, what the touched object needs, or both."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from tactile_hand_ros.compiled import Rows
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.loads import Split, split
from tactile_hand_ros.control.slip.detector import ContactState, SlipDetector, SlipDetectorConfig
from tactile_hand_ros.control.slip.friction import FrictionConfig, FrictionEstimator
from tactile_hand_ros.control.slip.grasp_force import (
    RequiredGraspForce,
    SlipResponse,
    SlipResponseConfig,
)
from tactile_hand_ros.errors import CollinearContactsError, MessageError

Array = NDArray[np.float64]


AGE = 20_000_000
"""What is gone back to is at least so old, where there is something, and at most twice [ns]."""


class _Known(NamedTuple):
    """What touch has taught: the friction, with all that belongs to it, and k_f, N."""

    friction: Rows
    grasp_force: float


class RollbackBuffer:
    """Keeps two states of something that learns, `AGE` apart."""

    def __init__(self) -> None:
        """Start without a past."""
        self.forget()

    def forget(self) -> None:
        """Forget the past: time or grasp are new."""
        self._kept: list[tuple[int, _Known]] = []

    def pass_by(self, stamp: int, known: Callable[[], _Known]) -> None:
        """Keep what is known at a tick [ns], when the newest state is old enough."""
        if not self._kept or stamp - self._kept[-1][0] >= AGE:
            self._kept = [*self._kept[-1:], (stamp, known())]

    @property
    def before(self) -> _Known | None:
        """What was known shortly before; None without a past."""
        return self._kept[0][1] if self._kept else None


_MEMORY = 4  # newest changes of the grasp force that may still show in the forces
_RESERVED = 0.8  # fraction of the limit up to which a reserve is kept; the rest is for real loads
_ON_ITS_WAY = 4_000_000  # ns for which any change may


class SlipRegulatorConfig(Config):
    """Parameters of the slip-prevention regulator."""

    hand: str = param("paper", "hand by name or YAML file")
    mode: Literal["user", "shared", "auto"] = param(
        "user",
        "user: the requested grasp force, auto: what the object needs, shared: the larger of both",
        live=True,
    )
    grasp_force: float = param(
        10.0, "grasp force k_f until the user asks for another", unit="N", gt=0.0
    )
    minimum: float = param(0.5, "minimum grasp force", unit="N", live=True, ge=0.0)
    maximum: float = param(
        40.0, "largest grasp force, the crush limit", unit="N", live=True, gt=0.0
    )
    rise_rate: float = param(50.0, "fastest rise the user may cause", unit="N/s", live=True, gt=0.0)
    fall_rate: float = param(20.0, "fastest fall the user may cause", unit="N/s", live=True, gt=0.0)
    smoothing: float = param(
        0.05,
        "time constant with which the grasp force lands on its goal",
        unit="s",
        live=True,
        gt=0.0,
    )
    detector: SlipDetectorConfig = SlipDetectorConfig()
    friction: FrictionConfig = FrictionConfig()
    reflex: SlipResponseConfig = SlipResponseConfig()

    @model_validator(mode="after")
    def _limits_are_ordered(self) -> SlipRegulatorConfig:
        if not self.minimum <= self.grasp_force <= self.maximum:
            raise ValueError(
                f"grasp_force = {self.grasp_force} N is outside minimum = {self.minimum} N to "
                f"maximum = {self.maximum} N"
            )
        return self


class SlipRegulator:
    """Chooses k_f at every tick, from touch alone.

    The user's grasp force moves at the rise or fall rate and lands exponentially. The grasp force
    that the object needs follows from the measured forces, split into load and internal force, and
    the friction that slips and sticks have shown: the minimum that keeps every contact inside its
    cone, with a margin. It rises immediately, falls slowly, and rises to the limit while something
    slips.

    Touch that is rejected is ignored. What it has taught shortly before is forgotten, and
    afterwards the need follows from the load that is measured then.

    Attributes:
        grasp_force: k_f, N.
        goal: Grasp force that the user asked for last, N; used inside the limits in force.
        needed: Grasp force that friction and load ask for, N; infinite when no grasp force of the
            present shape can hold, NaN while unknown or not looked at (mode user).
        ready: The same with a reserve for loads that may come, N.
        state: `ContactState` of each contact, shape (k,).
        learned_friction: mu of each contact as slips and sticks have shown it, shape (k,).
    """

    def __init__(self, config: SlipRegulatorConfig, fingers: int) -> None:
        """Start at the configured grasp force for a hand with k fingers."""
        self.config = config
        self._detector = SlipDetector(config.detector, fingers)
        self._estimator = FrictionEstimator(config.friction, fingers)
        self._required = RequiredGraspForce(config.reflex.need, fingers)
        self._normals = np.tile([0.0, 1.0, 0.0], (fingers, 1))
        self._response = SlipResponse(config.reflex, config.grasp_force)
        self._checkpoints = RollbackBuffer()
        self._doubted = False
        self.reset()

    def configure(self, config: SlipRegulatorConfig) -> None:
        """Take other limits, rates and mode; the grasp force moves on from where it is."""
        if config.mode != self.config.mode:
            self._asked = self.grasp_force
            self._response.start(self.grasp_force)
            self._required.reset()
        # What a limit has cut off would come back as a jump when the limit is lifted.
        self._asked = min(max(self._asked, config.minimum), config.maximum)
        self.config, self._response.config = config, config.reflex
        self._detector.configure(config.detector)
        self._estimator.configure(config.friction)
        self._required.configure(config.reflex.need)

    def reset(self) -> None:
        """Go back to the configured grasp force and forget what was learned."""
        start = self.config.grasp_force
        self.grasp_force: float = start
        self._asked = self.goal = start
        self._response.start(start)
        self.needed = self.ready = math.nan
        self._last_stamp: int | None = None
        self._required.reset()
        self._recent: deque[float] = deque(maxlen=3)
        self._bends: deque[tuple[int, float]] = deque()
        self._detector.reset()
        self._estimator.reset()
        self._checkpoints.forget()

    def reject_touch(self, doubted: bool) -> None:
        """Take whether touch is doubted, see `Controller.touch_rejected`, from the next tick on."""
        if doubted and not self._doubted:
            known = self._checkpoints.before
            if known is not None:
                self._estimator.restore(known.friction)
            force = self._response.grasp_force if known is None else known.grasp_force
            self._response.start(min(force, self._response.grasp_force))
            self._required.reset()
        self._doubted = doubted

    @property
    def state(self) -> NDArray[np.int64]:
        """`ContactState` of each contact, shape (k,)."""
        return self._detector.state

    @property
    def slip_likelihood(self) -> Array:
        """Evidence for slip of each contact, 0 to 1, shape (k,)."""
        return self._detector.likelihood

    @property
    def learned_friction(self) -> Array:
        """Friction of each contact as slips and sticks have shown it, shape (k,)."""
        return self._estimator.estimate

    def request(self, grasp_force: float) -> None:
        """Take the grasp force that the user asks for, in N.

        Raises:
            MessageError: If it is outside the limits or not a number.
        """
        c = self.config
        if not math.isfinite(grasp_force) or not c.minimum <= grasp_force <= c.maximum:
            raise MessageError(
                f"requested grasp force {grasp_force} N is outside {c.minimum} to {c.maximum} N; "
                "ask for one inside or change the limits 'minimum' and 'maximum'"
            )
        self.goal = grasp_force

    def step(
        self, stamp: int, contacts: Contacts | None = None, forces: Array | None = None
    ) -> float:
        """Return k_f in N at a tick; a tick that was seen before changes nothing.

        Args:
            stamp: The tick, ns.
            contacts: Contacts by touch; without them nothing is known of the object's need.
            forces: Measured forces in contact frames, shape (k, 3), N.
        """
        dt = 0.0 if self._last_stamp is None else max(0.0, 1e-9 * (stamp - self._last_stamp))
        if self._last_stamp == stamp:
            return self.grasp_force
        self._last_stamp = stamp
        self._follow_user(dt)
        if contacts is not None and forces is not None:
            if self._doubted:
                forces = np.full_like(forces, np.nan)
            else:
                self._checkpoints.pass_by(stamp, self._known)
            self._feel(stamp, contacts, forces, dt)
        c = self.config
        goal = self._asked
        if c.mode != "user":
            reflex = self._response.grasp_force
            goal = reflex if c.mode == "auto" else max(self._asked, reflex)
        self.grasp_force = min(max(goal, c.minimum), c.maximum)
        return self.grasp_force

    def _known(self) -> _Known:
        return _Known(self._estimator.memory, self._response.grasp_force)

    def _follow_user(self, dt: float) -> None:
        c = self.config
        goal = min(max(self.goal, c.minimum), c.maximum)
        rate = min(max((goal - self._asked) / c.smoothing, -c.fall_rate), c.rise_rate)
        arrives = abs(rate * dt) >= abs(goal - self._asked)
        self._asked = goal if arrives else self._asked + rate * dt

    def _feel(self, stamp: int, contacts: Contacts, forces: Array, dt: float) -> None:
        """Update slip, friction and the needed grasp force from touch."""
        if self.config.mode == "user":  # which needs no estimate of what would hold
            self.needed = self.ready = math.nan
            self._watch(stamp, contacts, forces, self._normals, dt)
            return
        parts = self._split(contacts, forces)
        axes = self._normals if parts is None else parts.internal
        grips = self._watch(stamp, contacts, forces, axes, dt)
        self.needed, self.ready = self._needed(parts, dt)
        slips = ContactState.SLIP in grips
        agrees = self._detector.agrees.tolist()
        slides = (ContactState.SLIP, True) in zip(grips, agrees, strict=True)
        limit, touching = self.config.maximum, contacts.touching
        if not contacts.all_touching:
            slides = slides or self._strained(touching, forces)
        goal = max(self.needed, min(self.ready, _RESERVED * limit))
        self._response.step(goal, slips, slides, touching, limit, dt)

    def _strained(self, touching: NDArray[np.bool_], forces: Array) -> bool:
        """Return whether a contact that is left carries all that its friction is trusted with."""
        usable = self._usable_friction()
        tangential = np.hypot(forces[:, 0], forces[:, 2])
        return bool((tangential > usable * forces[:, 1])[touching].any())

    def _usable_friction(self) -> Array:
        return self.learned_friction / (1.0 + self.config.reflex.margin)

    def _watch(
        self, stamp: int, contacts: Contacts, forces: Array, axes: Array, dt: float
    ) -> list[int]:
        """Update detectors and friction; return the `ContactState` of each contact."""
        felt = forces
        if not contacts.all_touching:
            felt = np.where(contacts.touching[:, None], forces, np.nan)
        detector, estimator = self._detector, self._estimator
        state = detector.step(felt, axes, self._own_change(stamp), dt, estimator.estimate)
        estimator.step(felt, state, detector.evidence, dt, detector.agrees, detector.fresh)
        grips: list[int] = state.tolist()
        if ContactState.SLIP in grips:
            estimator.share()
        return grips

    def _own_change(self, stamp: int) -> float:
        """Return the largest second difference of k_f that may still be on its way through, N."""
        self._recent.append(self.grasp_force)
        bends = self._bends
        if len(self._recent) == 3:
            a, b, c = self._recent
            bends.append((stamp, abs(c - 2.0 * b + a)))
        while len(bends) > _MEMORY and bends[0][0] <= stamp - _ON_ITS_WAY:
            bends.popleft()
        return max([bend for _, bend in bends], default=0.0)

    def _split(self, contacts: Contacts, forces: Array) -> Split | None:
        """Split the forces where they form a grasp."""
        if self._doubted or not contacts.all_touching:
            return None
        try:
            return split(contacts, forces)
        except CollinearContactsError:
            return None

    def _needed(self, parts: Split | None, dt: float) -> tuple[float, float]:
        """Return the minimum grasp force that holds, and with a reserve, N; NaN while unknown."""
        if parts is None or parts.grasp_force <= 0.0:
            self._required.lose()
            return math.nan, math.nan
        return self._required.step(parts, self.learned_friction, dt, self.config.reflex.margin)
