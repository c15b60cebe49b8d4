# SPDX-License-Identifier: Apache-2.0
"""The grasp force k_f: requested by the user, required by the object, or both."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from tactile_hand_ros.compiled import Array, Rows
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts, in_contacts, in_palm
from tactile_hand_ros.control.loads import CarriedLoad, ReserveConfig, Split, split_part
from tactile_hand_ros.control.slip.detector import ContactState, SlipDetector, SlipDetectorConfig
from tactile_hand_ros.control.slip.friction import FrictionConfig, FrictionEstimator
from tactile_hand_ros.control.slip.grasp_force import (
    RequiredGraspForce,
    SlipResponse,
    SlipResponseConfig,
)
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.hand.hand import Hand, tip_forces
from tactile_hand_ros.hand.joints import Joints

_AGE = 20_000_000  # ns; a restored estimate is at least this old, and at most twice
_LANDING = 0.05  # s, time constant of the approach to the user's grasp force
_RESERVED = 0.8  # fraction of the limit for the reserve; the rest is for measured loads
_CLEAR_MARGIN = 1e-2  # collinearity margin above which forces give the load


class SlipRegulatorConfig(Config):
    """Parameters of the slip-prevention regulator."""

    hand: str = param("paper", "hand by name or YAML file")
    layout: str = param("", "layout of the hand's fingers; empty for its default")
    mode: Literal["user", "shared", "auto"] = param(
        "user",
        "user: requested grasp force, auto: the one that the object requires, shared: the larger",
        live=True,
    )
    grasp_force: float = param(10.0, "grasp force k_f before a user request", unit="N", gt=0.0)
    minimum: float = param(0.5, "minimum grasp force", unit="N", live=True, ge=0.0)
    maximum: float = param(40.0, "maximum grasp force, crush limit", unit="N", live=True, gt=0.0)
    rise_rate: float = param(50.0, "fastest rise by the user", unit="N/s", live=True, gt=0.0)
    fall_rate: float = param(20.0, "fastest fall by the user", unit="N/s", live=True, gt=0.0)
    detector: SlipDetectorConfig = SlipDetectorConfig()
    friction: FrictionConfig = FrictionConfig()
    reserve: ReserveConfig = ReserveConfig()
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

    The user's grasp force moves at the rise or fall rate. The required one is the minimum that
    keeps every contact inside its cone, with a margin, from the load in the measured forces and the
    learned friction. It rises immediately, falls slowly, and doubles again and again during a slip.
    A lost contact counts as one without force, so that the load that has removed it counts.

    Rejected touch is ignored. While a guard holds the joints, which shakes the grasp and which no
    k_f reaches, the required grasp force follows the load, but nothing is learned of slips. What
    was learned of the friction shortly before either of both is forgotten.

    A skin that measures normal forces only, at one finger or at all, shows neither load nor
    friction. The required grasp force is then unknown, and outside mode `user` k_f is the user's,
    raised by each slip until the next request.

    Attributes:
        hand: The hand, which knows its fingers and joints.
        grasp_force: k_f, N.
        goal: Grasp force that the user requested last, N; applied inside the limits.
        needed: Required grasp force, N; infinite if no grasp force of this shape holds, NaN while
            unknown.
        ready: The same with a reserve for further loads, N.
        carried: Load, usable friction and reserve behind both, for f*.
    """

    def __init__(self, config: SlipRegulatorConfig) -> None:
        """Start at the configured grasp force; raise HandModelError if the hand cannot be built."""
        self.config, self.hand = config, Hand.load(config.hand, config.layout)
        fingers = self._fingers = self.hand.fingers
        self._detector = SlipDetector(config.detector, fingers)
        self._estimator = FrictionEstimator(config.friction, fingers)
        self._required = RequiredGraspForce(config.reserve, fingers, self.hand.finger_weight)
        self._response = SlipResponse(config.reflex, config.grasp_force)
        self._rejected, self._held = np.zeros(fingers, dtype=bool), False
        self.reset()

    def configure(self, config: SlipRegulatorConfig) -> None:
        """Change limits, rates and mode; the grasp force continues from its value."""
        if config.mode != self.config.mode:
            self._asked, self._raised = self.grasp_force, 0.0
            self._response.start(self.grasp_force)
            self._required.reset()
        # Otherwise a raised limit would make the grasp force jump.
        self._asked = min(max(self._asked, config.minimum), config.maximum)
        self.config, self._response.config = config, config.reflex
        self._detector.configure(config.detector)
        self._estimator.configure(config.friction)
        self._required.config = config.reserve

    def reset(self) -> None:
        """Go back to the configured grasp force and the prior friction."""
        start = self.config.grasp_force
        self.grasp_force: float = start
        self._asked = self.goal = start
        self._response.start(start)
        self.needed = self.ready = math.nan
        self._last_stamp: int | None = None
        self._has_grasped = False  # since the reset
        self._raised = 0.0  # k_f after the last slip in normal forces, N; 0 without one
        self._steady = True  # whether k_f did not change in the last tick
        self._required.reset()
        self._grasp: Contacts | None = None  # the last with all contacts
        self._last = np.full((self._fingers, 3), np.nan)
        self._kept: list[tuple[int, Rows]] = []
        self._detector.reset()
        self._estimator.reset()
        unknown, usable = np.full((self._fingers, 3), np.nan), self._usable(self.learned_friction)
        self.carried = CarriedLoad(unknown, usable, self._required.reserve)

    def reject_touch(self, rejected: NDArray[np.bool_]) -> None:
        """Ignore the touch of some fingers, shape (k,), from the next tick on.

        See `Controller.touch_rejected`. Without any touch, the load is unknown.
        """
        if any(rejected & ~self._rejected):
            self._forget_slips()
        if all(rejected) and not all(self._rejected):
            self._required.reset()
        self._rejected = rejected

    @property
    def joints_held(self) -> bool:
        """Whether a guard holds the joints from the next tick on."""
        return self._held

    @joints_held.setter
    def joints_held(self, held: bool) -> None:
        if held and not self._held:
            self._forget_slips()
        self._held = held

    def _forget_slips(self) -> None:
        if self._kept:
            self._estimator.memory[:] = self._kept[0][1]

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
        """Learned mu of each contact, shape (k,)."""
        return self._estimator.estimate

    def _usable(self, friction: Array) -> Array:
        return friction / (1.0 + self.config.reflex.margin)

    def request(self, grasp_force: float) -> None:
        """Request a k_f in N for the user.

        Raises:
            MessageError: If it is outside the limits or not a number.
        """
        c = self.config
        if not math.isfinite(grasp_force) or not c.minimum <= grasp_force <= c.maximum:
            raise MessageError(
                f"requested grasp force {grasp_force} N is outside {c.minimum} to {c.maximum} N; "
                "ask for one inside or change the limits 'minimum' and 'maximum'"
            )
        self.goal, self._raised = grasp_force, 0.0

    def step(self, stamp: int, joints: Joints, contacts: Contacts, forces: Array) -> float:
        """Return k_f at a tick, ns, in N; the same tick again has no effect.

        Contacts are those by touch, and their measured forces in contact frames, (k, 3), N.
        """
        dt = 0.0 if self._last_stamp is None else max(0.0, 1e-9 * (stamp - self._last_stamp))
        if self._last_stamp == stamp:
            return self.grasp_force
        self._last_stamp = stamp
        self._follow_user(dt)
        self._follow_touch(stamp, joints, contacts, forces, dt)
        c = self.config
        goal = self._asked
        if c.mode != "user":
            reflex = self._response.grasp_force
            goal = reflex if c.mode == "auto" else max(self._asked, reflex)
        before, self.grasp_force = self.grasp_force, min(max(goal, c.minimum), c.maximum)
        self._steady = self.grasp_force == before
        return self.grasp_force

    def _follow_user(self, dt: float) -> None:
        c = self.config
        goal = min(max(self.goal, c.minimum), c.maximum)
        rate = min(max((goal - self._asked) / _LANDING, -c.fall_rate), c.rise_rate)
        arrives = abs(rate * dt) >= abs(goal - self._asked)
        self._asked = goal if arrives else self._asked + rate * dt

    def _follow_touch(
        self, stamp: int, joints: Joints, contacts: Contacts, measured: Array, dt: float
    ) -> None:
        """Update slip, friction and the needed grasp force from touch."""
        if not contacts.touching.any():
            self._estimator.reset()  # the next object may be another one
            self._raised = 0.0
        if any(self._rejected) and not all(self._rejected):
            contacts = contacts.without(self._rejected)
        touching, normals = contacts.touching, contacts.normals
        unknown = np.isnan(measured[:, ::2])
        if unknown.any():
            self._follow_normals(contacts, measured, dt)
            return
        # A sensor that is slower than the loop repeats its samples.
        fresh, self._last = (measured != self._last).any(axis=1), measured.copy()
        forces = in_palm(contacts.rotations, measured, 1.0)
        forces[~touching] = np.nan
        learns = not (all(self._rejected) or self._held)
        if learns and (not self._kept or stamp - self._kept[-1][0] >= _AGE):
            # To restore it when touch is rejected.
            self._kept = [*self._kept[-1:], (stamp, self._estimator.memory.copy())]
        parts, at = self._split(contacts, forces)
        grasped = self._is_grasped(contacts)
        axes = parts.internal if parts is not None and grasped else normals
        seen = forces if learns else np.full_like(forces, np.nan)
        slips, slides = self._watch(seen, normals, axes, fresh, joints, dt)
        self._update_need(contacts, parts, at, dt, grasped)
        if self.config.mode == "user":
            return
        if parts is not None and not self._has_grasped:
            # Another regulator may have crashed with the object in the hand.
            if parts.grasp_force > self._response.grasp_force:
                self._response.start(min(parts.grasp_force, self.config.maximum))
            self._has_grasped = True
        limit = self.config.maximum
        goal = max(self.needed, min(self.ready, _RESERVED * limit))
        known = self._known(touching)
        self._response.step(goal, slips, slides, known, self._rejected, limit, dt)

    def _follow_normals(self, contacts: Contacts, measured: Array, dt: float) -> None:
        """Update slip and the reflex from normal forces; measured are (k, 3), N, in part NaN.

        They show a change of k_f like a slip, so nothing is tested while k_f changes. Where others
        measure three axes, they may only fail for a while, and k_f does not fall.
        """
        touching, c, normal = contacts.touching, self.config, measured[:, 1]
        fresh, self._last[:, 1] = normal != self._last[:, 1], normal
        is_known = touching & self._steady & (not (all(self._rejected) or self._held))
        forces, axes = np.zeros((2, self._fingers, 3))
        axes[:, 1] = 1.0
        forces[:, 1] = np.where(is_known, normal, np.nan)
        state = self._detector.step(forces, axes, np.zeros_like(axes), fresh, dt, freedoms=1)
        self._update_need(contacts, None, axes, dt)
        if c.mode == "user":
            return
        if (state == ContactState.SLIP).any():
            self._raised = min(c.reflex.first_rise * self.grasp_force, c.maximum)
        goal = max(self._raised, self._asked)
        if not np.isnan(measured[:, ::2]).all():
            goal = max(goal, self._response.grasp_force)
        if self._is_grasped(contacts) or not touching.any():
            self._grasp = contacts if touching.any() else None
        known = self._known(touching)
        self._response.step(goal, False, False, known, self._rejected, c.maximum, dt)

    def _update_need(
        self, contacts: Contacts, parts: Split | None, at: Array, dt: float, grasped: bool = False
    ) -> None:
        """Update the required grasp force and the load, unknown without the parts of the forces."""
        friction, required = self.learned_friction, self._required
        usable = self._usable(friction)
        if parts is None:
            required.lose()
            self.needed = self.ready = math.nan
        else:
            needs = required.step(parts, at, friction, usable, dt, grasped=grasped)
            self.needed, self.ready = needs
        load = in_contacts(contacts.rotations, required.load)
        self.carried = CarriedLoad(load, usable, required.reserve)

    def _known(self, touching: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which contacts touch or are not part of the grasp, shape (k,)."""
        return touching if self._grasp is None else touching | ~self._grasp.touching

    def _is_grasped(self, contacts: Contacts) -> bool:
        """Return whether contacts balance by themselves; a rejected finger presses, too."""
        return contacts.enough_touching and not any(self._rejected)

    def _split(self, contacts: Contacts, forces: Array) -> tuple[Split | None, Array]:
        """Return the split of a grasp's forces and its normals, shape (k, 3), NaN: not grasped.

        Three contacts are a grasp (A7). With fewer, a lost contact counts at its last place without
        force. The load is then the part of the other forces without the direction of their internal
        force, which is not balanced any more.
        """
        touching, grasped = contacts.touching, self._is_grasped(contacts)
        if all(self._rejected) or not touching.any():
            self._grasp = None
        elif grasped:
            self._grasp = contacts
        if self._grasp is None:
            return None, contacts.normals
        held = self._grasp.touching
        at = (touching & held)[:, None]
        points = np.where(at, contacts.positions, self._grasp.positions)
        normals = np.where(at, contacts.normals, self._grasp.normals)
        seen = np.where(at, forces, 0.0)
        if not grasped:
            shape = np.where(at, self._required.internal, 0.0)
            square = float(np.vdot(shape, shape))
            seen -= (np.vdot(shape, seen) / square if square > 0.0 else 0.0) * shape
        parts = split_part(points, normals, seen, held)
        if parts.margin < _CLEAR_MARGIN or (grasped and parts.grasp_force <= 0.0):
            self._grasp = None
        return (None if self._grasp is None else parts), normals

    def _watch(
        self,
        forces: Array,
        normals: Array,
        axes: Array,
        fresh: NDArray[np.bool_],
        joints: Joints,
        dt: float,
    ) -> tuple[bool, bool]:
        """Update slip and friction; return whether a contact slips, and its newest sample slips.

        The axes are the directions of the internal forces, shape (k, 3).
        """
        detector, (theta, _, torque) = self._detector, joints
        pressed = None if torque is None else tip_forces(self.hand.fingertips(theta), torque)
        state = detector.step(forces, normals, axes, fresh, dt, pressed=pressed)
        agrees, suspected = detector.agrees, detector.likelihood > 0.0
        self._estimator.step(forces, normals, state, suspected, agrees, fresh, dt)
        slips = state == ContactState.SLIP
        return bool(slips.any()), bool((slips & agrees).any())
