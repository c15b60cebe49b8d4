# SPDX-License-Identifier: Apache-2.0
"""Where the hand is to bring its grasp, and when: desired poses and the smooth way to them."""

from __future__ import annotations

import bisect
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.reach import check_reach
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rodrigues, vector_from_rotation

Array = NDArray[np.float64]
_NEAR, _TURNED = 1e-3, 0.02  # m and rad; a reference that is nearer has arrived


class SmoothReference:
    """Follows desired poses like a critically damped spring, from where the grasp is.

    x'' = (x_d - x) / T^2 - 2 x' / T, the same for the rotation vector to the desired orientation,
    in steps that are exact for any time: with e = x - x_d and a = x' + e / T,
    e(t) = (e + a t) exp(-t / T) and x'(t) = (x' - a t / T) exp(-t / T).
    """

    def __init__(self) -> None:
        """Start without a pose."""
        self.reset()

    def reset(self) -> None:
        """Forget where the reference is."""
        self._pose: Target | None = None
        self._rates = np.zeros(6)  # velocity, and the rate of the rotation vector
        self._error = np.zeros(6)  # from the target to the pose, m and rad

    @property
    def is_moving(self) -> bool:
        """Whether it is still on its way."""
        way, turn = np.linalg.norm(self._error[:3]), np.linalg.norm(self._error[3:])
        return bool(way > _NEAR or turn > _TURNED)

    def step(self, target: Target, now: AuxiliaryPose, time: float, dt: float) -> Target:
        """Return the pose to follow at this tick.

        Args:
            target: Desired pose.
            now: Pose of the grasp, from which the first step begins.
            time: T in s; 0 gives the desired pose itself.
            dt: Time since the last tick, s.
        """
        if time <= 0.0:
            self.reset()
            return target
        if self._pose is None:
            self._pose, self._rates = Target(now.position, now.orientation), np.zeros(6)
        turn = vector_from_rotation(self._pose.orientation @ target.orientation.T)
        error = np.concatenate([self._pose.position - target.position, turn])
        fading, course = math.exp(-dt / time), self._rates + error / time
        error = fading * (error + dt * course)
        self._rates = fading * (self._rates - dt / time * course)
        orientation = rodrigues(*error[3:]) @ target.orientation
        self._pose = Target(target.position + error[:3], orientation)
        self._error = error
        return self._pose


MAX_WAITING = 1000
"""Desired poses that may wait for their tick."""

MAX_CHECKED = 1
"""Desired poses whose reach is checked when they come, in one tick; that of others is checked when
they are due. A pose out of reach takes milliseconds, and a flood of them must not cost the grip."""


class Grasp(NamedTuple):
    """A grasp as it was last seen.

    Attributes:
        theta: Joint angles, shape (m,), rad.
        contacts: Contacts by touch.
        pose: Contact centroid and virtual frame.
    """

    theta: Array
    contacts: Contacts
    pose: AuxiliaryPose


class _QueuedPose(NamedTuple):
    """A desired pose that waits for its tick.

    Attributes:
        stamp: Tick from which it holds, ns; zero for the next.
        target: The pose.
        judged: Whether it is known to be in reach of the present grasp.
    """

    stamp: int
    target: Target
    judged: bool


class TargetQueue:
    """Keeps desired poses until they are due; the newest due one in reach becomes the target.

    Attributes:
        target: The desired pose in force; None before the first tick.
        accepted: The desired pose that became the target in this tick; None if none did.
        dropped: Desired poses that were forgotten because too many waited.
    """

    def __init__(self, hand: Hand) -> None:
        """Judge by the reach of a hand."""
        self._hand = hand
        self.accepted: Target | None = None
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Forget all poses."""
        self.target: Target | None = None
        self._queue: list[_QueuedPose] = []
        self._in_reach: Target | None = None
        self._checked = 0

    def start_tick(self) -> None:
        """Take new poses again: a tick has time to check a few of them."""
        self._checked, self.accepted = 0, None

    def start_grasp(self) -> None:
        """Drop the target of the last grasp; poses that wait are judged by the new one."""
        self.target = self._in_reach = None
        self._queue = [queued._replace(judged=False) for queued in self._queue]

    def command(self, target: Target, stamp: int, now: int | None, grasp: Grasp | None) -> None:
        """Take a desired pose, and judge it now if there is a grasp and time for it.

        Args:
            target: Desired pose of the contact centroid's virtual frame, palm frame.
            stamp: Tick in ns from which it holds; zero or a past one means now.
            now: The last tick, ns; None before the first.
            grasp: The grasp as it was last seen; None before the first.

        Raises:
            PoseError: If the grasp cannot be carried there.
        """
        is_judged = grasp is not None and self._checked < MAX_CHECKED
        if grasp is not None and is_judged:
            self._checked += 1
            self._judge(target.kept(grasp.pose), grasp)
        self.schedule(target, stamp, now, judged=is_judged and target.is_whole)

    def schedule(self, target: Target, stamp: int, now: int | None, *, judged: bool) -> None:
        """Queue a desired pose as `command` does, without judging now whether it is in reach.

        Args:
            target: The pose.
            stamp: Tick in ns from which it holds; zero or a past one means now.
            now: The last tick, ns; None before the first.
            judged: Whether it is known to be in reach; otherwise it is judged when it is due.
        """
        if stamp <= (now or 0):
            stamp = 0
        bisect.insort(self._queue, _QueuedPose(stamp, target, judged), key=_due_at)
        if len(self._queue) > MAX_WAITING:
            del self._queue[0]
            self.dropped += 1

    def forget_after(self, stamp: int) -> list[int]:
        """Forget the desired poses for ticks after one, in ns; return the stamps they had."""
        first = bisect.bisect_right(self._queue, stamp, key=_due_at)
        forgotten = [queued.stamp for queued in self._queue[first:]]
        del self._queue[first:]
        return forgotten

    def take_due(self, stamp: int, grasp: Grasp) -> str:
        """Make the newest due pose the target; return why it was refused, if it was.

        Without a target the grasp stays where it was first seen. One tick has time to judge one
        pose: when it is refused, older ones come with the next tick.

        Args:
            stamp: The tick, ns.
            grasp: The grasp in this tick.
        """
        if self.target is None:
            self.stay(grasp.pose)
        count = bisect.bisect_right(self._queue, stamp, key=_due_at)
        if not count:
            return ""
        *older, newest = self._queue[:count]
        later = self._queue[count:]
        target = newest.target.kept(grasp.pose)
        try:
            if not newest.judged:
                self._judge(target, grasp)
        except PoseError as error:
            # Without their stamps, so that a pose that is commanded meanwhile comes after them.
            self._queue = [queued._replace(stamp=0) for queued in older] + later
            return str(error)
        self.target = self.accepted = target
        self._queue = later
        return ""

    def stay(self, pose: AuxiliaryPose) -> None:
        """Make the pose of the grasp the target."""
        self.target = Target(pose.position, pose.orientation)

    def _judge(self, target: Target, grasp: Grasp) -> None:
        """Check the reach of a pose, unless it is the one that was last found to be in reach.

        A rigid motion of the same grasp stays within reach. What was refused may not stay so: the
        hand may have come nearer.
        """
        known = self._in_reach
        if known is None or not all(map(np.array_equal, known[:2], target[:2])):
            check_reach(self._hand, *grasp, target)
            self._in_reach = target


def _due_at(queued: _QueuedPose) -> int:
    """Return the tick from which a waiting pose holds, ns."""
    return queued.stamp
