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

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.control.contact import Contacts, in_palm, joint_torques
from tactile_hand_ros.hand.hand import Fingertips, Hand

Array = NDArray[np.float64]


_STANDING = 0.2  # fraction of the tolerance of touch that contacts may move under still joints
_SUM = 1e-3  # largest error of sum f*_n = 1


def implausible_touch(tips: Fingertips, radii: Array, contacts: Contacts, tolerance: float) -> str:
    """Return why contacts and joints do not fit each other; empty if they do.

    Args:
        tips: Fingertips of the measured posture.
        radii: Radii of the fingertips, shape (k,), m.
        contacts: Contact points and frames; all must touch.
        tolerance: Largest distance between a contact and its fingertip, m.
    """
    gap = _largest_gap(tips.positions, radii, contacts.positions, contacts.rotations)
    if gap <= tolerance:
        return ""
    return f"a contact is {1e3 * gap:.0f} mm off its fingertip; holding until joints and touch fit"


def implausible_shape(optimal_forces: Array) -> str:
    """Return why f*, shape (k, 3), is no answer to (13); empty if it may be one."""
    total = float(optimal_forces[:, 1].sum())
    if math.fabs(total - 1.0) <= _SUM:
        return ""
    return f"the normal parts of f* add up to {total:.3g} instead of 1; holding until they do"


class FrozenJointCheck:
    """Finds joint angles that repeat to the bit although the contacts move."""

    def __init__(self) -> None:
        """Start without a past."""
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._theta: Array | None = None
        self._points = np.zeros((0, 3))

    def step(self, theta: Array, contacts: Contacts, tolerance: float) -> str:
        """Return why the joints are implausible; empty if they are not.

        Args:
            theta: Joint angles, shape (m,), rad.
            contacts: Contact points and frames; all must touch.
            tolerance: Distance that contacts may move under joints that do not move, m.
        """
        if self._theta is None or not np.array_equal(theta, self._theta):
            self._theta, self._points = theta.copy(), contacts.positions
            return ""
        if np.abs(contacts.positions - self._points).max() <= tolerance:
            return ""
        return "the joint angles do not change although the contacts move; holding until they do"


@compiled
def _largest_gap(centers: Array, radii: Array, points: Array, rotations: Array) -> float:
    """Return the largest |p_c - p_f - r n|, m."""
    largest = 0.0
    for i in range(len(points)):
        square = 0.0
        for axis in range(3):
            gap = points[i, axis] - centers[i, axis] - radii[i] * rotations[i, axis, 1]
            square += gap * gap
        largest = max(largest, square)
    return math.sqrt(largest)


FELT_TIME = 0.005
"""Time over which forces and torques are compared [s]."""

_FROZEN_TIME = 0.04  # s for which a slow skin may repeat a force to the bit
_FROZEN_FRACTION = 0.05  # change of the torques of a finger that changes the force of any skin
_SMALL = 0.05  # N m; a change of torque that any skin shows
_SPREAD = 0.02  # of the torques of all fingers that may show at one: they share object and model
_FINE_FRACTION, _FINE_SMALL = 0.01, 0.002  # the same of a skin without steps; N m
_STEPS = 3.0  # that a force of a skin with steps makes at least, of its finest ones


class _Frozen(NamedTuple):
    """Since when a finger repeats its force to the bit, ns; the force, N; torques then, N m."""

    stamp: int
    force: list[float]
    pressed: Array


class ForceTorqueCheck:
    """Compares the measured forces with the torques that the joints report.

    A skin's samples are some milliseconds old: its forces are those of one time since then.
    """

    def __init__(self, hand: Hand) -> None:
        """Start without a past."""
        self._least = hand.least_force * hand.spans
        self.reset()

    def reset(self) -> None:
        """Forget the past: time or grasp are new."""
        self._last: tuple[int, Array] | None = None
        self._pressed = self._felt = np.zeros(0)
        self._noise = np.zeros(len(self._least))
        self._began = 0
        self._past: deque[tuple[int, Array]] = deque()  # ticks, ns, and what was pressed then
        self._frozen: list[_Frozen] = []
        self._finest: list[float] = []  # smallest change of a component of each force, N

    def step(
        self,
        stamp: int,
        rates: Array,
        terms: tuple[Fingertips, Array, Array],
        contacts: Contacts,
        forces: Array,
        applied: Array,
        tolerance: float,
        latency: float = 0.0,
        rate_error: Array | float = 0.0,
    ) -> str:
        """Return why forces and torques do not fit each other; empty if they do.

        Both are averaged over `FELT_TIME`, within which a blow passes through the fingers.

        Args:
            stamp: The tick, ns.
            rates: Joint rates, shape (m,), rad/s.
            terms: Fingertips, M_h and C_h theta' + N_h at the tick.
            contacts: Contact points and frames; all must touch.
            forces: Measured forces in contact frames, shape (k, 3), N.
            applied: Torque since the last tick, shape (m,), N m.
            tolerance: Largest error of J_h^T f_c of a finger as a fraction of it.
            latency: Largest age of the forces, s. For so long after a reset nothing is compared.
            rate_error: How far the rates may be off, shape (m,), rad/s.
        """
        before, self._last = self._last, (stamp, rates)
        if before is None or stamp <= before[0]:
            return ""
        tips, inertia, bias = terms
        dt = 1e-9 * (stamp - before[0])
        pressed = applied - inertia @ (rates - before[1]) / dt - bias
        felt = joint_torques(*tips, contacts.positions, in_palm(contacts.rotations, forces, 1.0))
        if not self._past:
            self._pressed = self._felt = pressed
            self._began = stamp
        own = np.abs(tips.linear).max(axis=1) > 0.0
        fraction = 1.0 - math.exp(-dt / FELT_TIME)
        self._pressed = self._pressed + fraction * (pressed - self._pressed)
        if 1e-9 * (stamp - self._began) < latency:  # forces may be those of torques before
            felt = self._pressed
        self._felt = self._felt + fraction * (felt - self._felt)
        self._remember(stamp, latency)
        noise = own @ np.abs(inertia) @ np.broadcast_to(rate_error, rates.shape) / FELT_TIME
        self._noise = np.maximum(noise, (1.0 - fraction) * self._noise)
        limits = self._least + self._noise
        if not any(self._fits(past, own, tolerance, limits) for _, past in reversed(self._past)):
            return "forces and joint torques do not fit each other; holding until they do"
        if self._is_frozen(stamp, tips, forces, self._noise):
            return "the forces of a finger do not change although its torques do; holding"
        return ""

    def _remember(self, stamp: int, latency: float) -> None:
        """Keep what was pressed at the times that the forces may be of."""
        self._past.append((stamp, self._pressed))
        while 1e-9 * (stamp - self._past[0][0]) > latency:
            self._past.popleft()

    def _fits(
        self, pressed: Array, own: NDArray[np.bool_], tolerance: float, limits: Array
    ) -> bool:
        """Return whether what is measured may be what was pressed at some time.

        Args:
            pressed: Torques at that time, shape (m,), N m.
            own: Which joints move which finger, shape (k, m).
            tolerance: Largest error of a finger as a fraction.
            limits: Errors of each finger that show nothing, shape (k,), N m.
        """
        error, torque = (np.sqrt(own @ np.square(x)) for x in (self._felt - pressed, pressed))
        limit = limits + tolerance * (torque + _SPREAD * math.sqrt(pressed @ pressed))
        return bool((error <= limit).all())

    def _is_frozen(self, stamp: int, tips: Fingertips, forces: Array, noise: Array) -> bool:
        """Return whether a finger repeats its force to the bit for long, under another torque."""
        felt = forces.tolist()
        if not self._frozen:
            self._frozen = [_Frozen(stamp, force, self._pressed) for force in felt]
            self._finest = [math.inf] * len(felt)
        for i, (force, frozen) in enumerate(zip(felt, self._frozen, strict=True)):
            if force != frozen.force:
                changes = [abs(a - b) for a, b in zip(force, frozen.force, strict=True) if a != b]
                self._finest[i] = min(self._finest[i], *changes)
                self._frozen[i] = _Frozen(stamp, force, self._pressed)
            elif 1e-9 * (stamp - frozen.stamp) > _FROZEN_TIME:
                own = tips.linear[i].any(axis=0)
                change = np.abs((self._pressed - frozen.pressed)[own]).max()
                torque = np.abs(frozen.pressed[own]).max()
                if change > noise[i] + _noticeable(torque, tips.linear[i], self._finest[i]):
                    return True
        return False


def _noticeable(torque: float, linear: Array, finest: float) -> float:
    """Return the change of a finger's torque that its skin must notice, N m.

    Args:
        torque: Its largest torque before, N m.
        linear: Jacobian of its tip, shape (3, m), m.
        finest: Smallest change of its force so far, N; infinite before the first.
    """
    lever = math.sqrt(np.square(linear).sum(axis=0).max())
    fine = _FINE_SMALL + _FINE_FRACTION * torque + _STEPS * lever * finest
    return min(fine, _SMALL + _FROZEN_FRACTION * torque)


class Tolerances(NamedTuple):
    """How far joints and touch may differ.

    Attributes:
        touch: Distance of a contact from its fingertip, m.
        force: Difference between measured forces and joint torques, a fraction.
        latency: Age of measured forces, s.
        rates: How far joint rates may be off, shape (m,), rad/s; 0 where they are exact.
    """

    touch: float
    force: float
    latency: float
    rates: Array | float = 0.0


class InputCheck:
    """The one check of joints against touch: inconsistent or frozen inputs of either."""

    def __init__(self, hand: Hand) -> None:
        """Start without a past."""
        self._hand = hand
        self._forces, self._joints = ForceTorqueCheck(hand), FrozenJointCheck()

    def reset(self) -> None:
        """Forget the past: time or hand are new."""
        self.begin_grasp()
        self._joints.reset()

    def begin_grasp(self) -> None:
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
        """
        problem = ""
        if pressing is None:
            tips = self._hand.fingertips(theta)
        else:
            terms = self._hand.dynamics(theta, rates)
            tips = terms[0]
            problem = self._forces.step(
                stamp,
                rates,
                terms,
                contacts,
                *pressing,
                limits.force,
                limits.latency,
                limits.rates,
            )
        gap = implausible_touch(tips, self._hand.radii, contacts, limits.touch)
        frozen = self._joints.step(theta, contacts, _STANDING * limits.touch)
        return tips, problem or gap or frozen
