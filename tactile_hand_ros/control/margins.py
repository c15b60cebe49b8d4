# SPDX-License-Identifier: Apache-2.0
"""Margins of the assumptions A1 to A7, from joints and touch alone.

A margin is positive while its assumption holds. Where touch cannot measure a limit (A1, A3) it is
the quantity itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import Contacts, hand_jacobian
from tactile_hand_ros.control.grasp import collinearity_margin, joint_margin, net_wrench
from tactile_hand_ros.control.slip.detector import ContactState

if TYPE_CHECKING:  # the regulator computes margins, too, without a model of the hand
    from tactile_hand_ros.hand.hand import Hand

REACTION = 0.02
"""Time within which slip prevention must stop a slip (A6) [s]."""


TIP = np.array([1.0, 0.0, 0.0])
"""Direction of a fingertip in the frame of its link."""


def local_normals(normals: Array, tips: Array) -> Array:
    """Return palm-frame normals, (..., k, 3), in the frames of their tips, (..., k, 3, 3)."""
    return np.asarray(np.einsum("...ji,...j->...i", tips, normals))


def angles_between(a: Array, b: Array) -> Array:
    """Return the angles between unit vectors of shape (..., 3), shape (...), rad."""
    return np.asarray(np.arccos(np.clip((a * b).sum(axis=-1), -1.0, 1.0)))


@dataclass(frozen=True)
class GraspMargins:
    """Margins from joints and contacts.

    Attributes:
        face_travel: A1, largest distance of a contact on its fingertip from its first place, m.
            An edge of the face may be closer by that distance.
        hemisphere: A2, angle left to the rims of the fingertips, rad.
        joint: A5, minimum singular value of J_h, m/rad; 0 in a singular posture.
        collinearity: A7, second to first extent of the contacts; 0 on a line or with fewer than
            three.
    """

    face_travel: float
    hemisphere: float
    joint: float
    collinearity: float


UNKNOWN_MARGINS = GraspMargins(np.nan, np.nan, np.nan, 0.0)
"""Margins without a grasp: unknown, and A7 broken."""


class GraspMonitor:
    """Computes the margins of a grasp from its present and first contacts."""

    def __init__(self, hand: Hand) -> None:
        """Start without a grasp of a hand."""
        self._hand = hand
        self.reset()

    def reset(self) -> None:
        """Start with a new grasp."""
        self._first = np.full((self._hand.fingers, 3), np.nan)

    def margins(self, theta: Array, contacts: Contacts) -> GraspMargins:
        """Return the margins of a posture, (m,), rad, of the fingers that touch."""
        if not contacts.enough_touching:
            self.reset()
            return UNKNOWN_MARGINS
        touching = contacts.touching
        hand, contacts = self._hand.part(touching), contacts.part(touching)
        seen = np.full_like(self._first, np.nan)
        seen[touching] = local_normals(contacts.normals, hand.tip_rotations(theta))
        # A finger that touches again starts from its new contact.
        self._first = np.where(np.isnan(self._first) | ~touching[:, None], seen, self._first)
        travel = hand.radii * angles_between(seen[touching], self._first[touching])
        jacobian = hand_jacobian(hand.fingertips(theta), contacts.positions, contacts.rotations)
        return GraspMargins(
            face_travel=float(travel.max()),
            hemisphere=float(0.5 * np.pi - angles_between(seen[touching], TIP).max()),
            joint=joint_margin(jacobian),
            collinearity=collinearity_margin(contacts.positions),
        )


class SlipMonitor:
    """Worst margins of force and slip over all ticks since the last `clear`.

    Attributes:
        load: A3, largest net contact force, N: weight, acceleration and pulls.
        evidence: A4, evidence for slip left before an alarm, 1 to 0.
        cone: A4, minimum distance to a cone of the learned friction, N.
        time_left: A6, time left to stop a slip, s; negative if one has lasted too long.
    """

    def __init__(self) -> None:
        """Start without a slip."""
        self._since: int | None = None
        self.clear()

    def clear(self) -> None:
        """Start a new interval; a slip continues."""
        self.load = self.evidence = self.cone = np.nan
        self.time_left = REACTION

    def note(
        self,
        stamp: int,
        contacts: Contacts,
        forces: Array,
        learned_friction: Array,
        grip: NDArray[np.int_],
        likelihood: Array,
    ) -> None:
        """Update the margins with a tick, ns, its contacts, and measured forces, (k, 3), N.

        The learned mu, the `ContactState` and the evidence for slip, 0 to 1, have the shape (k,).
        """
        worst = self.load, self.evidence, self.cone
        touch = contacts.positions, contacts.rotations, forces
        noted = _noted(*worst, *touch, learned_friction, grip, likelihood)
        self.load, self.evidence, self.cone, slips = noted
        first = stamp if self._since is None else self._since
        self._since = first if slips else None
        if slips:
            self.time_left = min(self.time_left, REACTION - 1e-9 * (stamp - first))


@compiled
def _noted(
    load: float,
    evidence: float,
    cone: float,
    positions: Array,
    rotations: Array,
    forces: Array,
    learned_friction: Array,
    grip: NDArray[np.int_],
    likelihood: Array,
) -> tuple[float, float, float, bool]:
    """Return the worst of margins and a tick, NaN if both are unknown, and whether one slips."""
    x, y, z = net_wrench(positions, rotations, forces)[:3]
    load, slips = np.fmax(load, math.sqrt(x * x + y * y + z * z)), False
    for i in range(len(grip)):
        if grip[i] == ContactState.UNKNOWN:
            continue
        slip = grip[i] == ContactState.SLIP
        slips = slips or slip
        evidence = np.fmin(evidence, 0.0 if slip else 1.0 - likelihood[i])
        tangential = math.sqrt(forces[i, 0] ** 2 + forces[i, 2] ** 2)
        cone = np.fmin(cone, learned_friction[i] * forces[i, 1] - tangential)
    return load, evidence, cone, slips
