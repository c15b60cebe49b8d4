# SPDX-License-Identifier: Apache-2.0
"""Whether the hand can carry its grasp to a desired pose."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand

Array = NDArray[np.float64]

_TOLERANCE = 0.01  # m; rolling shifts the contacts by less than this matters
_ITERATIONS = 100
_LOOKS = 32  # postures that a check may look at: it runs inside a tick
_PACE, _PATIENCE = 300, 3  # so many steps like each of the last few are too far to go
_LEAST_DAMPING = 1e-12  # far above rounding, so that a redundant finger's system can be solved


def check_reach(
    hand: Hand, theta: Array, contacts: Contacts, pose: AuxiliaryPose, target: Target
) -> None:
    """Check that every fingertip can follow a rigid motion of the grasp to the target.

    Args:
        hand: The hand.
        theta: Joint angles now, shape (m,), rad.
        contacts: Contacts now; fingers that do not touch need not follow.
        pose: Contact centroid and virtual frame now.
        target: Desired pose.

    Raises:
        PoseError: If a fingertip would stay more than 10 mm short, or the pose is not finite.
    """
    if not (np.isfinite(target.position).all() and np.isfinite(target.orientation).all()):
        raise PoseError(
            f"desired pose {_text(target.position)} m is not a pose: position and orientation must "
            "be finite numbers"
        )
    hand, contacts = hand.part(contacts.touching), contacts.part(contacts.touching)
    turn = target.orientation @ pose.orientation.T
    tips = contacts.positions - hand.radii[:, None] * contacts.normals
    wanted = target.position + (tips - pose.position) @ turn.T
    missing = np.linalg.norm(wanted - hand.bases, axis=1) - hand.spans
    how = " even outstretched"
    if missing.max() <= _TOLERANCE:
        missing, how = _shortfall(hand, wanted, theta), ""
    worst = int(missing.argmax())
    if missing[worst] > _TOLERANCE:
        raise PoseError(
            f"desired pose {_text(target.position)} m is out of reach: {hand.finger_names[worst]} "
            f"would stay {1e3 * missing[worst]:.0f} mm short of its contact{how}; ask for a pose "
            f"closer to the present one, {_text(pose.position)} m"
        )


def _shortfall(hand: Hand, tips: Array, start: Array) -> Array:
    """Return how far fingertips stay away from given points, shape (k,), m.

    The search ends as soon as all are near enough, or when its pace is hopeless.
    """
    missing, length, slow = np.full(hand.fingers, np.inf), np.inf, 0
    for _, error in islice(_approach(hand, tips, start), _LOOKS):
        missing, before = np.linalg.norm(error, axis=1), length
        length = float(np.linalg.norm(error))
        if missing.max() <= _TOLERANCE or slow >= _PATIENCE:
            break
        if length < before:
            slow = slow + 1 if _PACE * (before - length) < length - _TOLERANCE else 0
    return missing


def _text(position: Array) -> str:
    return "(" + ", ".join(f"{x:.3f}" for x in position.round(3) + 0.0) + ")"  # no -0.000


def inverse_kinematics(hand: Hand, tips: Array, start: Array) -> tuple[Array, Array]:
    """Find joint angles that bring the fingertips closest to given points.

    Levenberg's damped least squares inside the joint limits.

    Args:
        hand: The hand.
        tips: Wanted fingertip centers in the palm frame, shape (k, 3), m.
        start: Joint angles to start from, shape (m,), rad.

    Returns:
        Joint angles, shape (m,), and remaining distances, shape (k,), m.
    """
    for theta, error in islice(_approach(hand, tips, start), _ITERATIONS + 1):
        if np.abs(error).max() < 1e-6:
            break
    return theta, np.linalg.norm(error, axis=1)


def _approach(hand: Hand, tips: Array, start: Array) -> Iterator[tuple[Array, Array]]:
    """Yield joint angles ever nearer to given fingertips, and what each tip lacks, shape (k, 3).

    The first are those of the start; after a step that led away the last ones come again. It ends
    where no step leads nearer.
    """
    lower, upper = hand.position_limits
    theta = np.clip(start, lower, upper)
    damping = 1e-4
    reached = hand.fingertips(theta)
    while damping <= 1e6:
        yield theta, tips - reached.positions
        error = (tips - reached.positions).ravel()
        jacobian = reached.linear.reshape(-1, hand.joints)
        normal = jacobian.T @ jacobian + damping * np.eye(hand.joints)
        trial = np.clip(theta + np.linalg.solve(normal, jacobian.T @ error), lower, upper)
        after = hand.fingertips(trial)
        if np.sum((tips - after.positions) ** 2) < error @ error:
            theta, reached, damping = trial, after, max(damping * 0.3, _LEAST_DAMPING)
        else:
            damping = damping * 10.0
