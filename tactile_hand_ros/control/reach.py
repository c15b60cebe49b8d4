# SPDX-License-Identifier: Apache-2.0
"""Whether the hand can move its grasp to a desired pose, and the room that is left.

As an object turns, the contacts roll over fingertips and object, and the frame through them turns
less than the object. Without slip a tip that turns by w against the object rolls its center by
r n x w, with the normal n and its radius r. The turn of the object for a desired pose of the
contacts is a fixed point. A contact must stay on the half sphere around its fingertip (A2).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import OFF_TIP, Contacts
from tactile_hand_ros.control.grasp import best_rotation, centered
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.margins import TIP, angles_between, local_normals
from tactile_hand_ros.errors import PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import vector_from_rotation

_MAX_POSTURES = 32  # postures of a check, which runs inside a tick
_ROUNDS, _ROUND_POSTURES = 6, 4  # of the rolling, and postures of each round
_ROLLED = 0.02  # of the radius, accuracy of the rolling: a degree
_MIN_DAMPING = 1e-12  # far above rounding, so that a redundant finger's system can be solved


def check_reach(
    hand: Hand, theta: Array, contacts: Contacts, pose: AuxiliaryPose, target: Target
) -> None:
    """Check that the fingertips reach the target and keep their contacts.

    Joint angles, (m,), rad, contacts and pose are those of now; only fingers that touch count.

    Raises:
        PoseError: If a fingertip would stay more than a sixth of its radius short of its contact,
            a contact would roll over the rim of its fingertip, or the pose is not finite.
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
    there, how = theta, " even outstretched"
    if (missing <= OFF_TIP * hand.radii).all():
        close, how = OFF_TIP * hand.radii, ""
        there, missing = inverse_kinematics(hand, wanted, theta, close, _MAX_POSTURES)
    worst = int((missing - OFF_TIP * hand.radii).argmax())
    if missing[worst] > OFF_TIP * hand.radii[worst]:
        raise PoseError(
            f"desired pose {_text(target.position)} m is out of reach: {hand.finger_names[worst]} "
            f"would stay {1e3 * missing[worst]:.0f} mm short of its contact{how}; ask for a pose "
            f"closer to the present one, {_text(pose.position)} m"
        )
    middle = target.position + turn @ (contacts.centroid - pose.position)
    left = _rolled(hand, theta, there, contacts, turn, middle)
    worst = int(left.argmin())
    if left[worst] < 0.0 <= _rims(hand, theta, contacts.normals).min():
        raise PoseError(
            f"desired pose {_text(target.position)} m turns the object so far that the contact of "
            f"{hand.finger_names[worst]} would roll {np.degrees(-left[worst]):.0f} degrees over the"
            " rim of its fingertip; ask for a smaller turn"
        )


def room(hand: Hand, theta: Array, contacts: Contacts) -> Array:
    """Return the fractions left of the ways to rims and joint limits, shape (k + m,).

    A way leads from the tip of a finger to its rim, or from the middle of a joint's range to its
    end; 1 for a joint without limits. All fingers touch.
    """
    lower, upper = hand.position_limits
    with np.errstate(divide="ignore", invalid="ignore"):
        joints = 2.0 * np.minimum(theta - lower, upper - theta) / (upper - lower)
    rims = _rims(hand, theta, contacts.normals) / (0.5 * np.pi)
    return np.append(rims, np.where(np.isfinite(joints), joints, 1.0))


def end_of(hand: Hand, i: int) -> str:
    """Return the end of way i of `room` in words; `hand` is the hand."""
    if i < hand.fingers:
        return f"the contact of {hand.finger_names[i]} to the rim of its fingertip"
    return f"{hand.joint_names[i - hand.fingers]} to its end"


def _rims(hand: Hand, theta: Array, normals: Array) -> Array:
    """Return the angles left to the rims of the fingertips (A2), shape (k,), rad."""
    seen = local_normals(normals, hand.tip_rotations(theta))
    return np.asarray(0.5 * np.pi - angles_between(seen, TIP))


def _rolled(
    hand: Hand, theta: Array, there: Array, contacts: Contacts, turn: Array, position: Array
) -> Array:
    """Return the angles left to the rims after rolling to a pose, shape (k,), rad.

    The joint angles `there`, shape (m,), rad, reach it without rolling. `turn`, shape (3, 3), turns
    the frame through the contacts, and `position`, shape (3,), m, is their new centroid.
    """
    points, normals, radii = contacts.positions, contacts.normals, hand.radii[:, None]
    before, body = hand.tip_rotations(theta), turn
    rolled = np.zeros_like(points)
    for _ in range(_ROUNDS):
        turns = body.T @ hand.tip_rotations(there) @ np.swapaxes(before, 1, 2)
        last, spins = rolled, np.array([vector_from_rotation(t) for t in turns])
        rolled = np.cross(radii * normals, spins)
        if np.abs(rolled - last).max() <= _ROLLED * hand.radii.min():
            break
        arms = centered(points + rolled)
        body = turn @ best_rotation(arms, centered(points))
        tips = position + (arms - radii * normals) @ body.T
        *_, (there, _) = islice(_approach(hand, tips, there), _ROUND_POSTURES)
    return _rims(hand, there, normals @ body.T)


def _text(position: Array) -> str:
    return "(" + ", ".join(f"{x:.3f}" for x in position.round(3) + 0.0) + ")"  # no -0.000


def inverse_kinematics(
    hand: Hand, tips: Array, start: Array, close: float | Array = 1e-6, postures: int = 101
) -> tuple[Array, Array]:
    """Return angles that bring the tips closest to points, (k, 3), m, and the distances, (k,), m.

    Levenberg's damped least squares inside the joint limits, from the angles `start`. It ends when
    all tips are close, m, or after a number of postures.
    """
    for theta, error in islice(_approach(hand, tips, start), postures):
        missing = np.linalg.norm(error, axis=1)
        if (missing <= close).all():
            break
    return theta, missing


def _approach(hand: Hand, tips: Array, start: Array) -> Iterator[tuple[Array, Array]]:
    """Yield joint angles, rad, closer and closer to given fingertips, and the errors, (k, 3), m.

    It starts with `start`, repeats the last angles after a step in a wrong direction, and stops
    when no step helps.
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
            theta, reached, damping = trial, after, max(damping * 0.3, _MIN_DAMPING)
        else:
            damping = damping * 10.0
