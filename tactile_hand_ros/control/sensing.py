# SPDX-License-Identifier: Apache-2.0
"""What the sensors of a hand leave open: joint rates, and how late torques and touch are.

Encoders have steps, drivers apply a torque some ticks later, and a skin is late, too. All three are
found while the hand works.
"""

from __future__ import annotations

import bisect
from collections import deque

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import OFF_TIP, Contacts, hand_jacobian, in_palm, tip_gaps
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.hand.hand import Fingertips, Hand

_WINDOW = 64  # number of angles; at rest their slope is one angle error over all of them
_ROUNDING = 0.01  # of the error, so that angles one step apart count as a line
_DELAY_TICKS = 64  # over which differences of torques are averaged
_SHOWN = 0.1  # smallest lever of a force that torques show, as a fraction of the largest
_SHORTEST = 1e-9  # m, keeps the distance of a contact from itself regular
_AGE_SAMPLES = 64  # over which the age of touch is averaged


class JointRates:
    """Estimates rates over the longest window in which the angles lie on a line.

    A filter with a fixed corner frequency turns each encoder step into a pulse of the rate, which
    damping turns into a pulse of force. This window is long at rest and at constant speed, so that
    a step counts for little. The rate is the middle of all slopes that fit, which jumps less than
    the slope from end to end. At an acceleration a it lags by sqrt(2 e a), with the error e.

    Source: Janabi-Sharifi, Hayward, Chen, Discrete-time adaptive windowing for velocity estimation,
    2000, for the window; Milanese, Belforte, 1982, for the middle.

    Attributes:
        error: Largest error of the rates, an angle error over the window, shape (m,), rad/s.
    """

    def __init__(self, joints: int) -> None:
        """Start without samples of m joints."""
        self._angles = np.zeros((_WINDOW, joints))
        self._times = np.zeros(_WINDOW)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._count, self.error = 0, np.zeros(self._angles.shape[1])

    def step(self, stamp: int, theta: Array, rates: Array, error: float) -> Array:
        """Return the joint rates at a tick, ns, with angles theta, rad, shape (m,), rad/s.

        They are the measured `rates` at the first tick, and if the largest `error` of an angle,
        rad, is 0.
        """
        if error == 0.0:
            self.error[:] = 0.0
            return rates
        time, before = 1e-9 * stamp, self._times[(self._count - 1) % _WINDOW]
        if self._count and time <= before:  # the same tick again, or a restart
            self._count = self._count - 1 if time == before else 0
        self._times[self._count % _WINDOW], self._angles[self._count % _WINDOW] = time, theta
        self._count += 1
        if self._count == 1:
            return rates
        rates, lengths = _slopes(self._times, self._angles, self._count, (1.0 + _ROUNDING) * error)
        self.error = error / lengths
        return rates


class TorqueDelay:
    """Finds after how many ticks the joints apply a torque.

    Changes of the reported torques are compared with changes of the sent ones, so that an offset
    does not count. Where noise hides them, or joints report no torques, the delay stays unknown.

    Attributes:
        ticks: The delay, 0 if a torque acts until the next tick; None if unknown.
    """

    def __init__(self, largest: int, joints: int) -> None:
        """Start without a delay; `largest` is the largest possible one, in ticks, of m joints."""
        self.ticks: int | None = None
        self._differences = np.zeros(largest + 1)
        self._sent = np.zeros((largest + 2, joints))  # the newest first
        self.pause()

    @property
    def allowed(self) -> int:
        """The delay to allow for, in ticks: the largest one if it is unknown."""
        return len(self._differences) - 1 if self.ticks is None else self.ticks

    def pause(self) -> None:
        """Forget what was sent, before other torques act; the delay remains."""
        self._count = 0
        self._applied: Array | None = None

    def step(self, applied: Array | None) -> None:
        """Compare torques that acted since the last tick, shape (m,), N m; None if unknown."""
        before, self._applied = self._applied, applied
        if before is None or applied is None or self._count < len(self._sent):
            return
        best = _best_delay(self._sent, applied - before, self._differences)
        if best >= 0:
            self.ticks = best

    def sent(self, torque: Array) -> None:
        """Record the torque that answers this tick, shape (m,), N m."""
        self._sent[1:] = self._sent[:-1]
        self._sent[0] = torque
        self._count += 1


@compiled
def _best_delay(sent: Array, change: Array, differences: Array) -> int:
    """Update the mean squared differences, shape (n,); return the delay that fits best.

    It is -1 unless it fits twice as well as any other. The change of the reported torques, (m,), is
    compared with changes of the sent ones, (n + 1, m), the newest first.
    """
    for n in range(len(differences)):
        total = 0.0
        for j in range(len(change)):
            away = sent[n, j] - sent[n + 1, j] - change[j]
            total += away * away
        differences[n] += (total - differences[n]) / _DELAY_TICKS
    best = int(np.argmin(differences))
    for n in range(len(differences)):
        if n != best and not differences[best] < 0.5 * differences[n]:
            return -1
    return best


@compiled
def _slopes(times: Array, angles: Array, count: int, error: float) -> tuple[Array, Array]:
    """Return slopes, rad/s, and durations, s, of the longest lines, each of shape (m,).

    Times, (n,), s, and angles, (n, m), rad, are rings into which `count` samples were written. The
    largest error of an angle is in rad.
    """
    n, newest = len(times), (count - 1) % len(times)
    slopes, lengths = np.zeros(angles.shape[1]), np.zeros(angles.shape[1])
    for joint in range(angles.shape[1]):
        low, high = -np.inf, np.inf  # slopes within the error of all angles so far
        for back in range(1, min(count, n)):
            at = (count - 1 - back) % n
            passed = times[newest] - times[at]
            moved = angles[newest, joint] - angles[at, joint]
            first, last = (moved - error) / passed, (moved + error) / passed
            if first > high or last < low:
                break
            low, high = max(low, first), min(high, last)
            slopes[joint], lengths[joint] = 0.5 * (low + high), passed
    return slopes, lengths


class UnfeltTouch:
    """Fills in the touch of fingers that press although their skin reports no contact.

    A finger that loses its object moves on, since nothing resists it. While the points of the
    fingers at the contacts keep their distances, as on a rigid object, the skin has failed instead.
    The contact then moves with the joints, and its force is that of the torques at rest (3).
    """

    def __init__(self, hand: Hand) -> None:
        """Start without a grasp of a hand."""
        self._hand, self._allowed = hand, OFF_TIP * hand.radii
        self._last: tuple[Array, Contacts] | None = None  # joint angles, and their contacts
        self._forces: Array | None = None
        self._strained = np.zeros((hand.fingers, hand.fingers))  # change of the distances, m

    def feel(self, theta: Array, contacts: Contacts, forces: Array | None) -> None:
        """Record the joint angles, contacts and forces of a tick at which all are felt."""
        self._last, self._forces = (theta, contacts), forces
        self._strained[:] = 0.0

    def lose(self) -> None:
        """Forget the contacts, until all are felt again."""
        self._last = None

    def filled(
        self,
        theta: Array,
        contacts: Contacts,
        forces: Array | None,
        unfelt: NDArray[np.bool_],
        torque: Array,
    ) -> tuple[Contacts, Array | None] | None:
        """Return contacts and forces of all fingers, those of the `unfelt` ones, (k,), filled in.

        None if they are unknown: without a touch of all, if no finger is felt, or if one has moved
        off the object. The forces, (k, 3), N, are in contact frames. The torque, (m,), N m, presses
        on the object.
        """
        if self._last is None or unfelt.all():
            return None
        (before, last), moved = self._last, theta - self._last[0]
        tips, touch = self._hand.fingertips(before), (last.positions, last.rotations)
        levers = hand_jacobian(tips, *touch)
        self._strained += _stretched(last, levers @ moved)
        if (np.abs(self._strained).max(axis=1) > self._allowed)[unfelt].any():
            self.lose()
            return None
        here = Contacts(*carried_along(tips, *touch, moved))
        filled = contacts.replaced(unfelt, here.part(unfelt))
        self._last = theta, filled
        if forces is not None and self._forces is not None:
            pressed = _pressed(levers.reshape(-1, len(theta)).T, torque, self._forces)
            forces = np.where(unfelt[:, None], pressed, forces)
        return filled, forces


def _pressed(levers: Array, torque: Array, last: Array) -> Array:
    """Return the forces that a torque shows, shape (k, 3), N.

    What it does not show, of a straight finger or one with fewer than three joints, stays the last.
    """
    before = np.nan_to_num(last).ravel()
    change = np.linalg.lstsq(levers, torque - levers @ before, rcond=_SHOWN)[0]
    return (before + change).reshape(-1, 3)


def _stretched(contacts: Contacts, moved: Array) -> Array:
    """Return by how much distances between contacts grow, shape (k, k), m.

    The points of the fingers there move by `moved`, in contact frames, shape (k, 3), m.
    """
    shifts = in_palm(contacts.rotations, moved, 1.0)
    apart = contacts.positions[:, None] - contacts.positions
    along = ((shifts[:, None] - shifts) * apart).sum(axis=2)
    return np.asarray(along / np.maximum(np.linalg.norm(apart, axis=2), _SHORTEST))


class LateTouch:
    """Finds how far the joints moved since the contact points of a tick were measured.

    A skin is late, and a slow one repeats its samples. A contact that was measured a time a ago is
    off its fingertip by -a J_f theta'. The age is a linear regression of gaps on tip speeds. Its
    intercepts are the errors of hand and skin; noise pulls the age towards 0. Motions too slow for
    a gap beyond the error of the angles show nothing.

    Attributes:
        age: The age of a new sample, 0 until it is known, s.
    """

    def __init__(self, hand: Hand) -> None:
        """Start without samples of a hand."""
        self._radii = hand.radii
        self._means, self._moments = np.zeros((2, hand.fingers, 3)), np.zeros(3)
        self.age = 0.0
        self._past: deque[tuple[int, Array]] = deque()  # ticks, ns, and their joint angles, rad
        # Contact points, m, and the joint angles when they were measured, rad.
        self._sample: tuple[Array, Array] | None = None

    def step(
        self,
        stamp: int,
        theta: Array,
        rates: Array | None,
        tips: Fingertips,
        contacts: Contacts,
        felt: NDArray[np.bool_],
        tick: float,
        largest: float,
        error: float,
    ) -> Array:
        """Return the motion of the joints since then, shape (m,), rad.

        Args:
            stamp: The tick, ns.
            theta: Joint angles, shape (m,), rad.
            rates: Joint rates, shape (m,), rad/s; None to learn nothing from this tick.
            tips: Fingertip centers and Jacobians.
            contacts: Contacts; all fingers touch.
            felt: Whether they are measured, shape (k,).
            tick: Time between ticks, s. Contacts younger than half of it are new.
            largest: Largest possible age, s.
            error: Largest error of an angle, rad.
        """
        self._past.append((stamp, theta))
        while self._past[0][0] < stamp - 1e9 * largest:
            self._past.popleft()
        if self._sample is None or (contacts.positions != self._sample[0])[felt].any():
            if rates is not None and largest > 0.0 and felt.all():
                self._learn(tips, rates, contacts, largest, error)
            then = theta if self.age < 0.5 * tick else self._angles_at(stamp - 1e9 * self.age)
            self._sample = contacts.positions, then
        return theta - self._sample[1]

    def _learn(
        self, tips: Fingertips, rates: Array, contacts: Contacts, largest: float, error: float
    ) -> None:
        """Learn the age from a new sample of the skin; see `step`."""
        gaps = tip_gaps(tips, contacts.positions, contacts.rotations, self._radii)
        memory = self._means, self._moments
        if _regress(tips.linear, rates, gaps, *memory, largest, error):
            speed, gap, both = self._moments
            spread = speed + gap / (_AGE_SAMPLES * largest * largest)
            self.age = min(max(-both / spread, 0.0), largest) if spread > 0.0 else 0.0

    def _angles_at(self, stamp: float) -> Array:
        """Return the joint angles at a past time in ns, shape (m,), rad, or the oldest known."""
        later = bisect.bisect_right(self._past, stamp, key=lambda past: past[0])
        (since, before), (until, after) = self._past[max(0, later - 1)], self._past[later]
        part = (stamp - since) / (until - since) if until > since else 0.0
        return before + part * (after - before)


@compiled
def _regress(
    linear: Array,
    rates: Array,
    gaps: Array,
    means: Array,
    moments: Array,
    largest: float,
    error: float,
) -> bool:
    """Add a sample, and return whether its speeds may show an age; see `LateTouch.step`.

    Args:
        linear: Jacobians J_f of the fingertips, shape (k, 3, m), m/rad.
        rates: Joint rates, shape (m,), rad/s.
        gaps: Contacts less the points p_f + r n of the fingertips, shape (k, 3), m.
        means: Of speeds and gaps, shape (2, k, 3); updated.
        moments: Variances of speeds and gaps, and their covariance, shape (3,); updated.
        largest: Largest possible age, s.
        error: Largest error of an angle, rad.
    """
    speeds, shown, hidden = np.zeros(gaps.shape), 0.0, 0.0
    for i in range(len(gaps)):
        for axis in range(3):
            lever = 0.0
            for j in range(len(rates)):
                speeds[i, axis] += linear[i, axis, j] * rates[j]
                lever += abs(linear[i, axis, j])
            shown += (largest * speeds[i, axis]) ** 2
            hidden += (error * lever) ** 2
    if shown <= hidden:
        return False
    fraction = 1.0 / _AGE_SAMPLES
    for i in range(len(gaps)):
        for axis in range(3):
            speed, gap = speeds[i, axis] - means[0, i, axis], gaps[i, axis] - means[1, i, axis]
            means[0, i, axis] += fraction * speed
            means[1, i, axis] += fraction * gap
            moments[0] += fraction * speed * speed
            moments[1] += fraction * gap * gap
            moments[2] += fraction * speed * gap
    moments *= 1.0 - fraction
    return True
