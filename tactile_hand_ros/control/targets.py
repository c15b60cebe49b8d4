# SPDX-License-Identifier: Apache-2.0
"""Desired poses of the grasp: a queue by tick, and a smooth reference on the way to them."""

from __future__ import annotations

import bisect
import math
import operator
from typing import NamedTuple

import numpy as np

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.reach import check_reach
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rodrigues, vector_from_rotation

_NEAR, _TURNED = 1e-3, 0.02  # m and rad; closer is arrived


class SmoothReference:
    """Moves from the pose of the grasp to desired poses like a critically damped spring.

    x'' = (x_d - x) / T^2 - 2 x' / T, and the same for the rotation vector to the desired
    orientation. Steps are exact for any time: with e = x - x_d and a = x' + e / T,
    e(t) = (e + a t) exp(-t / T) and x'(t) = (x' - a t / T) exp(-t / T).
    """

    def __init__(self) -> None:
        """Start without a pose."""
        self.reset()

    def reset(self) -> None:
        """Forget the pose."""
        self._pose: Target | None = None
        self._rates = np.zeros(6)  # velocity, and the rate of the rotation vector
        self._error = np.zeros(6)  # from the target to the pose, m and rad

    @property
    def is_moving(self) -> bool:
        """Whether it has not arrived yet."""
        error = self._error.tolist()
        return math.hypot(*error[:3]) > _NEAR or math.hypot(*error[3:]) > _TURNED

    def step(self, target: Target, now: AuxiliaryPose, time: float, dt: float) -> Target:
        """Return the pose to follow at this tick, `dt` s after the last one.

        The first step starts at the pose of the grasp. T = 0 s gives the desired pose itself.
        """
        if time <= 0.0:
            self.reset()
            return target
        if self._pose is None:
            self._pose = Target(now.position, now.orientation)
        poses = *self._pose[:2], target.position, target.orientation
        *pose, self._error, self._rates = _approached(*poses, self._rates, time, dt)
        self._pose = Target(*pose)
        return self._pose


@compiled
def _approached(
    position: Array,
    orientation: Array,
    end: Array,
    turned: Array,
    rates: Array,
    time: float,
    dt: float,
) -> tuple[Array, Array, Array, Array]:
    """Return the next pose on the way to (end, turned), its error and rates, shape (6,)."""
    turn = vector_from_rotation(orientation @ turned.T)
    error = np.concatenate((position - end, turn))
    fading, course = math.exp(-dt / time), rates + error / time
    error = fading * (error + dt * course)
    rates = fading * (rates - dt / time * course)
    return end + error[:3], rodrigues(error[3], error[4], error[5]) @ turned, error, rates


MAX_WAITING = 1000
"""Number of desired poses that may wait for their tick."""


class Grasp(NamedTuple):
    """A grasp at one tick: joint angles, shape (m,), rad, contacts by touch, and their pose."""

    theta: Array
    contacts: Contacts
    pose: AuxiliaryPose


class _QueuedPose(NamedTuple):
    """A desired pose that waits for its tick, ns, zero for the next.

    It is judged if it was found to be in reach of the present grasp.
    """

    stamp: int
    target: Target
    judged: bool


_due_at = operator.attrgetter("stamp")


class TargetQueue:
    """Keeps desired poses until they are due; the newest one becomes the target if it is in reach.

    Attributes:
        target: The desired pose in force; None before the first tick.
        accepted: The desired pose that became the target in this tick, or None.
        grasp: The last grasp; None before the first.
        dropped: Number of desired poses that were dropped because too many waited.
    """

    def __init__(self, hand: Hand, refusal: str) -> None:
        """Start without poses for a hand, whose reach decides; any `refusal` rejects them all."""
        self._hand, self._refusal = hand, refusal
        self.accepted: Target | None = None
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Forget all poses."""
        self.target: Target | None = None
        self._queue: list[_QueuedPose] = []
        self._in_reach: Target | None = None
        self.grasp: Grasp | None = None
        self._now: int | None = None
        self._may_check = True

    def start_tick(self, now: int | None) -> None:
        """Start a tick, ns: a pose may be checked again."""
        self._now, self._may_check, self.accepted = now, True, None

    def start_grasp(self) -> None:
        """Drop the target of the last grasp; waiting poses are checked against the new one."""
        self.target = self._in_reach = None
        self._queue = [queued._replace(judged=False) for queued in self._queue]

    def command(self, target: Target, stamp: int = 0) -> None:
        """Queue a desired pose from a tick in ns on; zero or a past one means now.

        If `MAX_WAITING` poses wait already, the earliest is dropped. An unreachable one is rejected
        here or, without a grasp or after another one in this tick, when it is due: a check takes
        milliseconds, and many must not delay the controller.

        Raises:
            PoseError: If the present grasp cannot be moved there.
        """
        is_judged = False
        if self.grasp is not None and self._may_check:
            kept = target.kept(self.grasp.pose)
            self._may_check, is_judged = False, kept is target
            self._judge(kept, self.grasp)
        self.schedule(target, stamp, judged=is_judged)

    def schedule(self, target: Target, stamp: int, *, judged: bool) -> None:
        """Queue a desired pose as `command` does; `judged` is whether its reach was checked."""
        if stamp <= (self._now or 0):
            stamp = 0
        bisect.insort(self._queue, _QueuedPose(stamp, target, judged), key=_due_at)
        if len(self._queue) > MAX_WAITING:
            del self._queue[0]
            self.dropped += 1

    def forget_after(self, stamp: int) -> list[int]:
        """Drop the desired poses for ticks after a stamp in ns, and return their stamps, ns."""
        first = bisect.bisect_right(self._queue, stamp, key=_due_at)
        forgotten = [queued.stamp for queued in self._queue[first:]]
        del self._queue[first:]
        return forgotten

    def take_due(self, stamp: int, grasp: Grasp) -> str:
        """Make the newest due pose the target; return why it was rejected, empty if it was not.

        It replaces the older ones that are due. Without a target the grasp stays where it was first
        seen.
        """
        self.grasp = grasp
        if self.target is None:
            self.stay(grasp.pose)
        count = bisect.bisect_right(self._queue, stamp, key=_due_at)
        if not count:
            return ""
        newest = self._queue[count - 1]
        del self._queue[:count]
        target = newest.target.kept(grasp.pose)
        try:
            if not newest.judged:
                self._judge(target, grasp)
        except PoseError as error:
            return str(error)
        self.target = self.accepted = target
        return ""

    def stay(self, pose: AuxiliaryPose) -> None:
        """Make the pose of the grasp the target."""
        self.target = Target(pose.position, pose.orientation)

    def _judge(self, target: Target, grasp: Grasp) -> None:
        """Check the reach of a pose, unless it was the last one found to be in reach.

        A pose stays in reach of the same grasp. A rejected one may come into reach.
        """
        if self._refusal:
            raise PoseError(self._refusal)
        known = self._in_reach
        if known is None or not all(map(np.array_equal, known[:2], target[:2])):
            check_reach(self._hand, *grasp, target)
            self._in_reach = target
