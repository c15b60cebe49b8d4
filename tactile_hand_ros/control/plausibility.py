# SPDX-License-Identifier: Apache-2.0
"""Whether joints, touch and f* fit each other: what does not fit is wrong, however it looks.

A blind hand has no truth to compare with, but it knows some things twice:

- A contact lies on its fingertip: p_c = p_f(theta) + r n. Wrong joint angles and wrong contact
  points break that.
- The normal forces of (13) add up to one: sum f*_n = 1.
- What the contacts press is what the motors press, by (3):
  J_h^T f_c = tau - M_h theta'' - C_h theta' - N_h. Each finger is compared by itself: forces of one
  that are out of proportion or turned, and forces that do not change while its torque does, break
  that. What the noise of the encoders may make up is no error.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import OFF_TIP, Contacts, in_palm, joint_torques
from tactile_hand_ros.hand.hand import Fingertips, Hand
from tactile_hand_ros.rotations import vector_from_rotation

Array = NDArray[np.float64]


_STANDING = 0.5  # fraction of the tolerance of touch that contacts may move under still joints
_SUM = 1e-3  # largest error of sum f*_n = 1


def implausible_touch(tips: Fingertips, contacts: Contacts, radii: Array, allowed: Array) -> str:
    """Return why contacts and joints do not fit each other; empty if they do.

    Args:
        tips: Fingertips of the measured posture.
        contacts: Contact points and frames; all must touch.
        radii: Radii of the fingertips, shape (k,), m.
        allowed: Largest distances of the contacts from their fingertips, shape (k,), m.
    """
    off = contacts.positions - tips.positions - radii[:, None] * contacts.normals
    gaps = np.sqrt((off * off).sum(axis=1))
    if (gaps <= allowed).all():
        return ""
    gap = 1e3 * gaps[gaps > allowed].max()
    return f"a contact is {gap:.2g} mm off its fingertip; holding until joints and touch fit"


def implausible_shape(optimal_forces: Array) -> str:
    """Return why f*, shape (k, 3), is no answer to (13); empty if it may be one."""
    total = float(optimal_forces[:, 1].sum())
    if math.fabs(total - 1.0) <= _SUM:
        return ""
    return f"the normal parts of f* add up to {total:.3g} instead of 1; holding until they do"


COMPARISON_TIME = 0.005
"""Time over which forces and torques are compared [s]."""

_TURN_TIME = 0.01  # s over which rates of a turning palm are averaged
_SPREAD = 0.02  # of the torques of all fingers that may show at one: they share object and model
_FROZEN_FRACTION = 0.05  # change of the torques of a finger that changes the force of any skin
_FINE_FRACTION = 0.01  # the same of a skin that has shown its finest steps
_STEPS = 3.0  # that a force of a skin with steps makes at least, of its finest ones


class Tolerances(NamedTuple):
    """How far joints and touch may differ.

    Attributes:
        touch: Distance of a contact from its fingertip, m; 0 for a sixth of its radius.
        force: Difference between measured forces and joint torques, a fraction.
        latency: Age of measured forces, s.
        rates: How far joint rates may be off, shape (m,), rad/s; 0 where they are exact.
    """

    touch: float
    force: float
    latency: float
    rates: Array | float = 0.0


class _Repeat(NamedTuple):
    """Since when a finger repeats its force to the bit.

    Attributes:
        stamp: When it has come, ns.
        force: The force, N.
        pressed: Torques of all joints then, shape (m,), N m.
        finest: Smallest change of a component of its force so far, N; infinite before the first.
    """

    stamp: int
    force: list[float]
    pressed: Array
    finest: float


class ForceTorqueCheck:
    """Compares the measured forces with the torques that the joints report.

    A skin's samples are some milliseconds old: its forces are those of one time since then.
    """

    def __init__(self, hand: Hand) -> None:
        """Start without a past."""
        self._minimum = hand.minimum_force * hand.spans
        reach = float(np.max(np.linalg.norm(hand.bases, axis=1) + hand.spans))
        self._swung = hand.finger_mass * reach * hand.spans  # per 1/s^2, kg m^2
        self.reset()

    def reset(self) -> None:
        """Forget the past: time or grasp are new."""
        self._last: tuple[int, Array] | None = None
        self._pressed = self._measured = np.zeros(0)
        self._noise = np.zeros(len(self._minimum))
        self._started = 0
        self._past: deque[tuple[int, Array]] = deque()  # ticks, ns, and what was pressed then
        self._repeats: list[_Repeat] = []
        self._palm: Array | None = None
        self._spin, self._acceleration = np.zeros(3), np.zeros(3)  # of the palm, rad/s and rad/s^2

    def step(
        self,
        stamp: int,
        rates: Array,
        terms: tuple[Fingertips, Array, Array],
        contacts: Contacts,
        forces: Array,
        applied: Array,
        limits: Tolerances,
        palm: Array | None = None,
    ) -> str:
        """Return why forces and torques do not fit each other; empty if they do.

        Both are averaged over `COMPARISON_TIME`, within which a blow passes through the fingers.

        Args:
            stamp: The tick, ns.
            rates: Joint rates, shape (m,), rad/s.
            terms: Fingertips, M_h and C_h theta' + N_h at the tick.
            contacts: Contact points and frames; all must touch.
            forces: Measured forces in contact frames, shape (k, 3), N.
            applied: Torque since the last tick, shape (m,), N m.
            limits: Largest error of J_h^T f_c of a finger as a fraction of it, age of the forces,
                for which nothing is compared after a reset, and errors of the rates.
            palm: Rotation of the palm in the world, shape (3, 3); None where it is not known.
        """
        before, self._last = self._last, (stamp, rates)
        if before is None or stamp <= before[0]:
            return ""
        tips, inertia, bias = terms
        dt = 1e-9 * (stamp - before[0])
        pressed = applied - inertia @ (rates - before[1]) / dt - bias
        seen = in_palm(contacts.rotations, forces, 1.0)
        measured = joint_torques(*tips, contacts.positions, seen)
        if not self._past:
            self._pressed = self._measured = pressed
            self._started = stamp
        own = np.abs(tips.linear).max(axis=1) > 0.0
        fraction = 1.0 - math.exp(-dt / COMPARISON_TIME)
        self._pressed = self._pressed + fraction * (pressed - self._pressed)
        if 1e-9 * (stamp - self._started) < limits.latency:  # forces may be those of torques before
            measured = self._pressed
        self._measured = self._measured + fraction * (measured - self._measured)
        self._remember(stamp, limits.latency)
        noise = own @ np.abs(inertia) @ np.broadcast_to(limits.rates, rates.shape) / COMPARISON_TIME
        noise = noise + self._swung * self._turning(palm, dt)
        self._noise = np.maximum(noise, (1.0 - fraction) * self._noise)
        if not any(self._fits(past, own, limits.force) for _, past in reversed(self._past)):
            return "forces and joint torques do not fit each other; holding until they do"
        if self._is_frozen(stamp, tips, own, forces, limits.latency):
            return "the forces of a finger do not change although its torques do; holding"
        return ""

    def _remember(self, stamp: int, latency: float) -> None:
        """Keep what was pressed at the times that the forces may be of."""
        self._past.append((stamp, self._pressed))
        while 1e-9 * (stamp - self._past[0][0]) > latency:
            self._past.popleft()

    def _fits(self, pressed: Array, own: NDArray[np.bool_], tolerance: float) -> bool:
        """Return whether what is measured may be what was pressed at some time.

        Args:
            pressed: Torques at that time, shape (m,), N m.
            own: Which joints move which finger, shape (k, m).
            tolerance: Largest error of a finger as a fraction.
        """
        error, torque = (np.sqrt(own @ np.square(x)) for x in (self._measured - pressed, pressed))
        shown = torque + _SPREAD * math.sqrt(pressed @ pressed)
        limit = self._minimum + self._noise + tolerance * shown
        return bool((error <= limit).all())

    def _turning(self, palm: Array | None, dt: float) -> float:
        """Return how large apparent accelerations per lever arm may be as the palm turns, 1/s^2."""
        before, self._palm = self._palm, palm
        if before is None or palm is None:
            return 0.0
        fraction, last = -math.expm1(-dt / _TURN_TIME), self._spin
        self._spin = last + fraction * (vector_from_rotation(before.T @ palm) / dt - last)
        change = (self._spin - last) / dt - self._acceleration
        self._acceleration = self._acceleration + fraction * change
        return float(np.linalg.norm(self._acceleration) + self._spin @ self._spin)

    def _is_frozen(
        self, stamp: int, tips: Fingertips, own: NDArray[np.bool_], forces: Array, latency: float
    ) -> bool:
        """Return whether a finger repeats its force to the bit for long, under another torque.

        It may do so for twice the age of forces, since a sample may be lost, and while the torque
        changes by less than a skin with its steps shows.
        """
        if not self._repeats:
            first = [_Repeat(stamp, force, self._pressed, math.inf) for force in forces.tolist()]
            self._repeats = first
        for i, (force, last) in enumerate(zip(forces.tolist(), self._repeats, strict=True)):
            if force != last.force:
                changes = [abs(a - b) for a, b in zip(force, last.force, strict=True) if a != b]
                finest = min(last.finest, *changes)
                self._repeats[i] = _Repeat(stamp, force, self._pressed, finest)
            elif 1e-9 * (stamp - last.stamp) > 2.0 * latency + COMPARISON_TIME:
                change = np.abs((self._pressed - last.pressed)[own[i]]).max()
                lever = math.sqrt(np.square(tips.linear[i]).sum(axis=0).max())
                torque = np.abs(last.pressed[own[i]]).max()
                fine = _FINE_FRACTION * (torque + self._minimum[i]) + _STEPS * lever * last.finest
                shown = min(fine, _FROZEN_FRACTION * torque + self._minimum[i])
                if change > self._noise[i] + shown:
                    return True
        return False


class InputCheck:
    """The one check of joints against touch: inconsistent or frozen inputs of either."""

    def __init__(self, hand: Hand) -> None:
        """Start without a past."""
        self._hand = hand
        self._forces = ForceTorqueCheck(hand)
        self._theta, self._points = np.full(hand.joints, np.nan), np.zeros((hand.fingers, 3))

    def start_grasp(self) -> None:
        """Compare no forces with torques from before: a contact or the grasp is new."""
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
    ) -> tuple[Fingertips, str]:
        """Return the fingertips, and why joints and touch do not fit; empty if they do.

        Args:
            stamp: The tick, ns.
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s.
            contacts: Contact points and frames; all must touch.
            limits: How far they may differ.
            pressing: Measured forces in contact frames, shape (k, 3), N, and the torques applied
                since the last tick, shape (m,), N m; None where they are not compared.
            palm: Rotation of the palm in the world, shape (3, 3); None where it is not known.
        """
        problem = ""
        if pressing is None:
            tips = self._hand.fingertips(theta)
        else:
            terms = self._hand.dynamics(theta, rates)
            tips, _, _ = terms
            problem = self._forces.step(stamp, rates, terms, contacts, *pressing, limits, palm)
        radii = self._hand.radii
        allowed = np.full(len(radii), limits.touch) if limits.touch > 0.0 else OFF_TIP * radii
        gap = implausible_touch(tips, contacts, radii, allowed)
        return tips, problem or gap or self._frozen(theta, contacts, allowed)

    def _frozen(self, theta: Array, contacts: Contacts, allowed: Array) -> str:
        """Return why the joint angles are implausible: they repeat to the bit as contacts move."""
        if not np.array_equal(theta, self._theta):
            self._theta, self._points = theta.copy(), contacts.positions
            return ""
        moved = np.abs(contacts.positions - self._points).max(axis=1)
        if (moved <= _STANDING * allowed).all():
            return ""
        return "the joint angles do not change although the contacts move; holding until they do"
