# SPDX-License-Identifier: Apache-2.0
"""Releasing an object and grasping it again, finger by finger, by touch."""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.reach import inverse_kinematics
from tactile_hand_ros.hand.hand import Hand


class RegraspConfig(Config):
    """Distance and speed with which the fingers open and close."""

    opening: float = param(0.015, "distance by which the fingertips open", unit="m", gt=0.0, le=0.1)
    speed: float = param(0.02, "speed of the opening or closing tips", unit="m/s", gt=0.0, le=1.0)
    overtravel: float = param(
        0.02, "distance beyond the last contacts that the fingers search", unit="m", ge=0.0, le=0.1
    )


class Regrasp:
    """Moves the fingertips along the normals of the last grasp, outwards or inwards.

    A finger that touches while closing waits for the others, so that it does not push the object.

    Attributes:
        active: Whether the fingers are open, opening or closing.
        closing: Whether they are on their way back to the object.
        missed: Why closing failed, after which the fingers open again; empty otherwise.
    """

    def __init__(self, config: RegraspConfig, hand: Hand) -> None:
        """Start with a hand that grasps."""
        self._config, self._hand, self.missed = config, hand, ""
        self.finish()

    def leave(self, theta: Array, contacts: Contacts) -> None:
        """Start to open from the joint angles, (m,), rad, and contacts of a grasp; stay open."""
        self.active = True
        self._normals = np.where(contacts.touching[:, None], contacts.normals, 0.0)
        self._tips = self._hand.fingertips(theta).positions
        self._depth = np.zeros(self._hand.fingers)
        self._posture = theta.copy()
        self.open()

    def open(self) -> None:
        """Start to open again, along the normals of the last grasp."""
        self.closing, self.missed = False, ""

    def close(self) -> None:
        """Start to close."""
        self.closing, self.missed = True, ""

    def finish(self) -> None:
        """Stop: the hand grasps again."""
        self.active = self.closing = False

    def searches(self, contacts: Contacts) -> bool:
        """Return whether a finger without contact can close further; `contacts` are by touch."""
        return bool((self._depth < self._config.overtravel)[~contacts.touching].any())

    def follow(self, theta: Array) -> None:
        """Continue from a posture, shape (m,), rad, that another cause has moved the joints to."""
        if self.active:
            moved = self._depth[:, None] * self._normals
            self._tips = self._hand.fingertips(theta).positions - moved
            self._posture = theta.copy()

    def posture(self, contacts: Contacts, dt: float) -> Array:
        """Return the joint angles to hold now, shape (m,), rad, `dt` s after the last tick.

        The contacts are those by touch. Call `leave` first.
        """
        c = self._config
        if self.closing:
            self._give_up(contacts)
            moves = np.where(contacts.touching, 0.0, c.speed * dt)
            self._depth = np.minimum(self._depth + moves, c.overtravel)
        else:
            self._depth = np.maximum(self._depth - c.speed * dt, -c.opening)
        tips = self._tips + self._depth[:, None] * self._normals
        self._posture, _ = inverse_kinematics(self._hand, tips, self._posture)
        return self._posture

    def _give_up(self, contacts: Contacts) -> None:
        """Open again if the fingers without contact have searched the full distance."""
        missing = np.flatnonzero(~contacts.touching)
        if len(missing) and not self.searches(contacts):
            names = [self._hand.finger_names[i] for i in missing]
            self.closing = False
            self.missed = (
                f"{', '.join(names)} closed {1e3 * self._config.overtravel:.0f} mm beyond the last "
                "contacts without touching; the hand is open again: place the object between the "
                "fingers and grasp, or raise regrasp.overtravel"
            )
