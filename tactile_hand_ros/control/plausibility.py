# SPDX-License-Identifier: Apache-2.0
"""Whether joints, touch and f* are consistent, by quantities that are measured twice.

- A contact lies on its fingertip: p_c = p_f(theta) + r n. Wrong joint angles and wrong contact
  points break that.
- The normal forces of (13) add up to one: sum f*_n = 1.
- Contact forces and joint torques balance, J_h^T f_c = tau - M_h theta'' - C_h theta' - N_h (3), in
  each finger and up to the noise of the encoders. Scaled, turned and frozen forces break that.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import OFF_TIP, Contacts, in_palm, joint_torques, tip_gaps
from tactile_hand_ros.hand.hand import Dynamics, Fingertips, Hand
from tactile_hand_ros.rotations import vector_from_rotation

_STANDING = 0.5  # fraction of the tolerance of touch that contacts may move while the joints rest
_SUM = 1e-3  # largest error of sum f*_n = 1


Fingers = NDArray[np.bool_]


class Doubt(NamedTuple):
    """Why joints and touch disagree, and the fingers whose touch may be wrong, shape (k,)."""

    reason: str
    fingers: Fingers


def implausible_touch(
    tips: Fingertips, contacts: Contacts, radii: Array, allowed: Array
) -> Doubt | None:
    """Return where contacts and joints disagree; None if they do not.

    All fingers touch. Their radii and the largest distances of the contacts from their tips have
    the shape (k,), m.
    """
    gaps = tip_gaps(tips, contacts.positions, contacts.rotations, radii)
    lengths = np.linalg.norm(gaps, axis=1)
    away = ~(lengths <= allowed)
    if not away.any():
        return None
    gap = 1e3 * lengths[away].max()
    reason = f"a contact is {gap:.2g} mm off its fingertip; holding until joints and touch fit"
    return Doubt(reason, away)


def implausible_shape(optimal_forces: Array) -> str:
    """Return why f*, shape (k, 3), cannot solve (13); empty if it may."""
    total = float(optimal_forces[:, 1].sum())
    if math.fabs(total - 1.0) <= _SUM:
        return ""
    return f"the normal parts of f* add up to {total:.3g} instead of 1; holding until they do"


COMPARISON_TIME = 0.005
"""Time over which forces and torques are compared [s]."""

_MISFIT = "forces and joint torques do not fit each other; holding until they do"
_FROZEN = "the forces of a finger do not change although its torques do; holding"
_TURN_TIME = 0.01  # s over which rates of a turning palm are averaged
_SPREAD = 0.02  # of the torques of all fingers that may appear in one, by object and model
_FROZEN_FRACTION = 0.05  # change of a finger's torques that changes the force of any skin
_FINE_FRACTION = 0.01  # the same for a skin with known steps
_STEPS = 3.0  # smallest change that counts for a skin with steps, in steps


class Tolerances(NamedTuple):
    """Largest differences of joints and touch.

    Attributes:
        touch: Distance of a contact from its fingertip, m; 0 for a sixth of its radius.
        force: Difference between measured forces and joint torques, a fraction.
        latency: Age of measured forces, s.
        rates: Error of joint rates, shape (m,) or (1,), rad/s; 0 for exact rates.
    """

    touch: float
    force: float
    latency: float
    rates: Array = np.zeros(1)


class _Repeat(NamedTuple):
    """The last change of a finger's force: its tick, ns, force, N, and the torques then, N m.

    `finest` is the smallest change of a component of the force so far, N, infinite at first.
    """

    stamp: int
    force: list[float]
    pressed: Array
    finest: float


class ForceTorqueCheck:
    """Compares measured forces with joint torques.

    Samples of a skin are some milliseconds old, so their forces may match any torque since then.
    """

    def __init__(self, hand: Hand) -> None:
        """Start without samples of a hand."""
        self._own = hand.moves.astype(float)  # 1 for the joints of a finger, shape (k, m)
        self._minimum = hand.minimum_force * hand.spans
        reach = float(np.max(np.linalg.norm(hand.bases, axis=1) + hand.spans))
        self._swung = hand.finger_mass * reach * hand.spans  # per 1/s^2, kg m^2
        self.reset()

    def reset(self) -> None:
        """Forget the past, for another time or grasp."""
        self._last: tuple[int, Array] | None = None
        self._pressed = self._measured = np.zeros(0)
        self._noise = np.zeros(len(self._minimum))
        self._started = 0
        self._past: deque[tuple[int, Array]] = deque()  # ticks, ns, and their torques, N m
        self._repeats: list[_Repeat] = []
        self._palm: Array | None = None
        self._spin, self._acceleration = np.zeros(3), np.zeros(3)  # of the palm, rad/s and rad/s^2

    def step(
        self,
        stamp: int,
        rates: Array,
        terms: Dynamics,
        contacts: Contacts,
        forces: Array,
        applied: Array,
        limits: Tolerances,
        palm: Array | None = None,
    ) -> Doubt | None:
        """Return where forces and torques disagree; None if they do not.

        Both are averaged over `COMPARISON_TIME`, within which an impact passes through the fingers.
        No forces are compared for their latency after a reset. All fingers must touch.

        Args:
            stamp: The tick, ns.
            rates: Joint rates, shape (m,), rad/s.
            terms: Fingertips, M_h and C_h theta' + N_h at the tick.
            contacts: Contact points and frames.
            forces: Measured forces in contact frames, shape (k, 3), N.
            applied: Torque since the last tick, shape (m,), N m.
            limits: Largest differences.
            palm: Rotation of the palm in the world, shape (3, 3); None if unknown.
        """
        before, self._last = self._last, (stamp, rates)
        if before is None or stamp <= before[0]:
            return None
        dt = 1e-9 * (stamp - before[0])
        acceleration, touch = (rates - before[1]) / dt, (contacts.positions, contacts.rotations)
        seen = *touch, forces, applied, acceleration, limits.rates / COMPARISON_TIME
        pressed, measured, noise = _torques(terms, *seen, self._own)
        if not self._past:
            self._pressed = self._measured = pressed
            self._started = stamp
        fraction = 1.0 - math.exp(-dt / COMPARISON_TIME)
        self._pressed = self._pressed + fraction * (pressed - self._pressed)
        if 1e-9 * (stamp - self._started) < limits.latency:  # forces may belong to earlier torques
            measured = self._pressed
        self._measured = self._measured + fraction * (measured - self._measured)
        self._past.append((stamp, self._pressed))  # at which the forces may have been measured
        while 1e-9 * (stamp - self._past[0][0]) > limits.latency:
            self._past.popleft()
        noise = noise + self._swung * self._turning(palm, dt)
        self._noise = np.maximum(noise, (1.0 - fraction) * self._noise)
        misfits = self._misfits(limits.force)
        if misfits.any():
            return Doubt(_MISFIT, misfits)
        frozen = self._frozen(stamp, terms.tips, forces, limits.latency)
        return Doubt(_FROZEN, frozen) if frozen.any() else None

    def _misfits(self, tolerance: float) -> Fingers:
        """Return the fingers whose forces do not fit the torques at the time that fits most, (k,).

        The tolerance is a fraction.
        """
        fewest = np.ones(len(self._own), dtype=bool)
        for _, pressed in reversed(self._past):
            seen = self._measured, pressed, self._minimum + self._noise
            misfits = _differ(self._own, *seen, tolerance)
            if not misfits.any():
                return misfits
            if misfits.sum() < fewest.sum():
                fewest = misfits
        return fewest

    def _turning(self, palm: Array | None, dt: float) -> float:
        """Return the largest apparent acceleration per lever arm of a turning palm, 1/s^2."""
        before, self._palm = self._palm, palm
        if before is None or palm is None:
            return 0.0
        fraction, last = -math.expm1(-dt / _TURN_TIME), self._spin
        self._spin = last + fraction * (vector_from_rotation(before.T @ palm) / dt - last)
        change = (self._spin - last) / dt - self._acceleration
        self._acceleration = self._acceleration + fraction * change
        return float(np.linalg.norm(self._acceleration) + self._spin @ self._spin)

    def _frozen(self, stamp: int, tips: Fingertips, forces: Array, latency: float) -> Fingers:
        """Return which fingers repeat their force bit for bit although their torque changes, (k,).

        It may do so for twice the latency, since a sample may be lost, and while the torque changes
        by less than the steps of the skin.
        """
        if not self._repeats:
            first = [_Repeat(stamp, force, self._pressed, math.inf) for force in forces.tolist()]
            self._repeats = first
        frozen = np.zeros(len(forces), dtype=bool)
        for i, (force, last) in enumerate(zip(forces.tolist(), self._repeats, strict=True)):
            if force != last.force:
                changes = [abs(a - b) for a, b in zip(force, last.force, strict=True) if a != b]
                finest = min(last.finest, *changes)
                self._repeats[i] = _Repeat(stamp, force, self._pressed, finest)
            elif 1e-9 * (stamp - last.stamp) > 2.0 * latency + COMPARISON_TIME:
                own = self._own[i] > 0.0
                change = np.abs((self._pressed - last.pressed)[own]).max()
                lever = math.sqrt(np.square(tips.linear[i]).sum(axis=0).max())
                torque = np.abs(last.pressed[own]).max()
                fine = _FINE_FRACTION * (torque + self._minimum[i]) + _STEPS * lever * last.finest
                shown = min(fine, _FROZEN_FRACTION * torque + self._minimum[i])
                frozen[i] = change > self._noise[i] + shown
        return frozen


@compiled
def _torques(
    terms: Dynamics,
    points: Array,
    rotations: Array,
    forces: Array,
    applied: Array,
    acceleration: Array,
    errors: Array,
    own: Array,
) -> tuple[Array, Array, Array]:
    """Return the torques on the object, (m,), N m, that joints (3) and forces, (k, 3), N, show.

    And the torque in each finger, (k,), N m, of errors of the acceleration, (m,) or (1,), rad/s^2;
    `own` is 1 for its joints, (k, m).
    """
    tips, inertia, bias = terms
    shown = joint_torques(tips, points, in_palm(rotations, forces, 1.0))
    pressed = applied - inertia @ acceleration - bias
    return pressed, shown, own @ (np.abs(inertia) * errors).sum(axis=1)


@compiled
def _differ(own: Array, measured: Array, pressed: Array, least: Array, tolerance: float) -> Fingers:
    """Return in which fingers two torques, shape (m,), N m, differ by more than the least, (k,).

    A fraction of the torques is tolerated. `own` is 1 for the joints of each finger, (k, m).
    """
    out = np.empty(len(own), dtype=np.bool_)
    spread = _SPREAD * math.sqrt(pressed @ pressed)
    for i in range(len(own)):
        error = math.sqrt(own[i] @ (measured - pressed) ** 2)
        shown = math.sqrt(own[i] @ pressed**2) + spread
        out[i] = not error <= least[i] + tolerance * shown
    return out


class InputCheck:
    """Checks joints against touch for inconsistent or frozen values."""

    def __init__(self, hand: Hand) -> None:
        """Start without samples of a hand."""
        self._hand = hand
        self._forces = ForceTorqueCheck(hand)
        self._theta, self._points = np.full(hand.joints, np.nan), np.zeros((hand.fingers, 3))

    def start_grasp(self) -> None:
        """Start with a new contact or grasp: older torques are not compared."""
        self._forces.reset()

    def step(
        self,
        stamp: int,
        theta: Array,
        rates: Array,
        contacts: Contacts,
        limits: Tolerances,
        pressing: tuple[Array, Array] | None,
        palm: Array | None = None,
    ) -> tuple[Fingertips, Doubt | None]:
        """Return the fingertips, and where joints and touch disagree; None if they do not.

        All fingers touch. `pressing` are the measured forces and the applied torque, None to
        compare neither; for these and the rest see `ForceTorqueCheck.step`.
        """
        doubt = None
        if pressing is None:
            tips = self._hand.fingertips(theta)
        else:
            terms = self._hand.dynamics(theta, rates)
            tips = terms.tips
            doubt = self._forces.step(stamp, rates, terms, contacts, *pressing, limits, palm)
        radii = self._hand.radii
        allowed = np.full(len(radii), limits.touch) if limits.touch > 0.0 else OFF_TIP * radii
        away = implausible_touch(tips, contacts, radii, allowed)
        away = away or self._frozen(theta, contacts, allowed)
        if away is None or (doubt is not None and not (away.fingers & ~doubt.fingers).any()):
            return tips, doubt
        # Either the joints or the touch are wrong, and nothing shows which.
        return tips, Doubt(away.reason, np.ones_like(away.fingers))

    def _frozen(self, theta: Array, contacts: Contacts, allowed: Array) -> Doubt | None:
        """Return whether the joint angles repeat bit for bit while contacts move."""
        if not np.array_equal(theta, self._theta):
            self._theta, self._points = theta.copy(), contacts.positions
            return None
        moved = np.abs(contacts.positions - self._points).max(axis=1)
        if (moved <= _STANDING * allowed).all():
            return None
        reason = "the joint angles do not change although the contacts move; holding until they do"
        return Doubt(reason, np.ones(len(moved), dtype=bool))
