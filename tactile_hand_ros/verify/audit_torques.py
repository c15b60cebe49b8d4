# SPDX-License-Identifier: Apache-2.0
"""Does every recorded torque follow from the law, at all ticks at which the hand drove?

The law is worked out here independently of the nodes. The hand's kinematics, the reference filter
and the load observer are theirs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import ControllerConfig
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.load_observer import LoadObserver
from tactile_hand_ros.control.reference import SmoothReference
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.verify.checks import Check, check
from tactile_hand_ros.verify.recorded_inputs import Effects, Inputs, Request, in_force
from tactile_hand_ros.verify.shapes import grasp_maps, rotations

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

Tips = tuple[Array, Array, Array]
"""Linear and angular Jacobians of the fingertips, shape (n, k, 3, m), and centres, (n, k, 3)."""

TORQUE_TOLERANCE = 1e-9  # N m
POSE_TOLERANCE = 1e-9  # m and rad

_TORQUE_CHECKS = {
    "optimal": "torque of law (14)",
    "contact": "torque of law (10)",
    "kawamura": "torque of law (8)",
}


def audit_torques(hand: Hand, inputs: Inputs) -> list[Check]:
    """Check what the hand believed and what it answered, at all ticks at which it drove."""
    record = inputs.record
    law = inputs.configurations[names.CONTROLLER][0].value.law.name  # it is not live
    drove = np.isfinite(record.auxiliary_position).all(axis=1)
    answered = np.isfinite(record.command).all(axis=1)
    known = np.isfinite(record.contact_positions).all(axis=(1, 2))
    rows = np.flatnonzero(drove & answered & known)
    name = _TORQUE_CHECKS.get(law, f"torque of {law}: not known to the audit")
    if not len(rows):
        return [check(name, record, rows, np.zeros(0), TORQUE_TOLERANCE, "N m")]
    tips = [hand.fingertips(record.theta[row]) for row in rows]
    linear, angular = np.array([t.linear for t in tips]), np.array([t.angular for t in tips])
    centres = np.array([t.positions for t in tips])
    points = record.contact_positions[rows]
    if law == "kawamura":
        points = centres
    off = np.abs(points.mean(axis=1) - record.auxiliary_position[rows]).max(axis=1)
    checks = [check("centroid", record, rows, off, POSE_TOLERANCE, "m")]
    if len(record.finger_names) == 3:
        turned = _frame_errors(points, record.auxiliary_quaternion[rows])
        checks.append(check("virtual frame", record, rows, turned, POSE_TOLERANCE, "rad"))
    if law not in _TORQUE_CHECKS:
        return [*checks, check(name, record, rows[:0], np.zeros(0), TORQUE_TOLERANCE, "N m")]
    torques = _law_torques(law, hand, rows, (linear, angular, centres), inputs)
    difference = np.abs(torques - record.command[rows]).max(axis=1)
    checks.append(check(name, record, rows, difference, TORQUE_TOLERANCE, "N m"))
    return checks


def _frame_errors(points: Array, quaternions: Array) -> Array:
    """Return how far the recorded frames are from those of three points, either side up."""
    frames = rotations(quaternions)
    along, across = points[:, 0] - points[:, 1], points[:, 0] - points[:, 2]
    normal = np.cross(along, across)
    x = along / np.linalg.norm(along, axis=1, keepdims=True)
    z = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.sign((z * frames[:, :, 2]).sum(axis=1, keepdims=True))
    errors: Array = np.maximum(
        np.abs(frames[:, :, 0] - x).max(axis=1), np.abs(frames[:, :, 2] - side * z).max(axis=1)
    )
    return errors


def _law_torques(law: str, hand: Hand, rows: NDArray[np.intp], tips: Tips, inputs: Inputs) -> Array:
    """Return the torques of a law at some ticks, shape (n, m)."""
    record = inputs.record
    configs = in_force(inputs.configurations[names.CONTROLLER], record.stamps[rows])
    renewed = _renewed(inputs, rows)
    follows = np.append(False, np.diff(_turns(inputs)[rows]) == 1) & ~renewed
    drive, carry = _wrenches(configs, rows, inputs, follows, renewed)
    if law == "kawamura":
        attitude = np.array([c.law.k_st * np.array(c.law.r_ref) for c in configs])
        reach = hand.radii.sum()
        grip, rest = _by_tips(tips, record.grasp_force[rows], reach, attitude, drive + carry)
    else:
        grip, rest = _by_contacts(law, tips, record, rows, drive + carry)
    rest -= np.array([[c.law.damping] for c in configs]) * record.rates[rows]
    torque, weights = np.empty(rest.shape), np.zeros(rest.shape)
    for i, config in enumerate(configs):
        if config.gravity_compensation:
            weights[i] = hand.gravity_torque(record.theta[rows[i]])
        torque[i] = rest[i] + _borne(grip[i], rest[i] + weights[i], hand.effort_limits)
    before = torque.copy()
    for i, config in enumerate(configs):
        if config.midpoint_hold and follows[i]:
            torque[i] += 0.5 * (before[i] - before[i - 1])
    return np.asarray(torque + weights)


def _by_tips(
    tips: Tips, grasp_force: Array, reach: float, attitude: Array, wrench: Array
) -> tuple[Array, Array]:
    """Return squeezing and moving torques of law (8), both of shape (n, m)."""
    linear, angular, centres = tips
    squeeze = grasp_force[:, None, None]
    pull = squeeze / reach * (centres.mean(axis=1, keepdims=True) - centres)
    grip = np.einsum("nkim,nki->nm", linear, pull)
    grip += np.einsum("nkim,ni->nm", angular, attitude)
    rest = np.einsum("nkim,ni->nm", linear, wrench[:, :3])
    rest += np.einsum("nkim,ni->nm", angular, wrench[:, 3:])
    return grip, rest


def _by_contacts(
    law: str, tips: Tips, record: Record, rows: NDArray[np.intp], wrench: Array
) -> tuple[Array, Array]:
    """Return squeezing and moving torques of law (14) or (10), both of shape (n, m)."""
    linear, angular, centres = tips
    points = record.contact_positions[rows]
    n, k = points.shape[:2]
    arms = points - centres
    turning = np.cross(angular, arms[:, :, :, None], axisa=2, axisb=2, axisc=2)
    jacobian = (linear + turning).reshape(n, 3 * k, linear.shape[-1])
    if law == "optimal":
        frames = rotations(record.contact_quaternions[rows])
        shape = np.einsum("nkij,nkj->nki", frames, record.optimal_forces[rows])
    else:
        shape = points.mean(axis=1, keepdims=True) - points
    squeeze = record.grasp_force[rows][:, None, None]
    inverse = np.linalg.pinv(grasp_maps(points))
    grip = np.einsum("nfm,nf->nm", jacobian, (squeeze * shape).reshape(n, -1))
    return grip, np.einsum("nfm,nf->nm", jacobian, np.einsum("nij,nj->ni", inverse, wrench))


def _borne(squeeze: Array, rest: Array, limits: Array) -> Array:
    """Return as much of a squeeze as keeps every joint that it overloads at its limit, (m,)."""
    overloaded = (np.abs(squeeze + rest) > limits) & (squeeze != 0.0)
    room = np.sign(squeeze) * limits - rest
    shares = room[overloaded] / squeeze[overloaded]
    return np.asarray(squeeze * np.clip(shares.min(initial=1.0), 0.0, 1.0))


def _turns(inputs: Inputs) -> NDArray[np.intp]:
    """Return the place of each tick among those that the controller answered, shape (n,)."""
    return np.cumsum(inputs.answered(inputs.record.command)) - 1


def _renewed(inputs: Inputs, rows: NDArray[np.intp]) -> Flags:
    """Return at which of some ticks the controller began with a new grasp, shape (n,).

    A reset takes effect at once; a hand that was opened drives again only with a new grasp.
    """
    renewed = np.zeros(len(rows), dtype=np.bool_)
    for stamp, request in inputs.requests.get(names.CONTROLLER, ()):
        if request.service == "reset" or request == Request("grasp", False):
            renewed[np.searchsorted(inputs.record.stamps[rows], stamp) :][:1] = True
    return renewed


def _wrenches(
    configs: list[ControllerConfig],
    rows: NDArray[np.intp],
    inputs: Inputs,
    follows: Flags,
    renewed: Flags,
) -> tuple[Array, Array]:
    """Return what moves and what carries the object at some ticks, both of shape (n, 6).

    Args:
        configs: Configuration in force at each of them.
        rows: The ticks.
        inputs: Their inputs.
        follows: Those at which the controller drove at the tick that it answered before.
        renewed: Those that begin a new grasp.
    """
    record = inputs.record
    frames = rotations(record.auxiliary_quaternion[rows])
    observer, reference = LoadObserver(), SmoothReference()
    integral = np.zeros(6)
    drive, carry = np.zeros((len(rows), 6)), np.zeros((len(rows), 6))
    target: Target | None = None
    poses = Effects(inputs.poses)
    for i, (row, config) in enumerate(zip(rows, configs, strict=True)):
        dt = 1e-9 * float(record.stamps[row] - record.stamps[rows[i - 1]]) if follows[i] else 0.0
        if not follows[i]:
            reference.reset()
        if renewed[i]:
            target, integral = None, np.zeros(6)
            observer.reset()
        now = AuxiliaryPose(record.auxiliary_position[row], frames[i])
        target = target or Target(now.position, now.orientation)
        contacts = Contacts(
            record.contact_positions[row],
            rotation_from_quaternion(record.contact_quaternions[row]),
        )
        for target in poses.until(int(record.stamps[row])):
            pass  # of several the last one holds
        wanted = reference.step(target, now, config.reference_time, dt)
        error = np.concatenate(
            [
                wanted.position - now.position,
                np.cross(now.orientation, wanted.orientation, axisa=0, axisb=0).sum(axis=0),
            ]
        )
        drive[i] = error * np.repeat([config.law.k_p, config.law.k_o], 3)
        integral = _integrated(config, integral, error, dt)
        carry[i] = integral
        if config.law.observer.time == 0.0:
            observer.reset()
        else:
            carry[i] += observer.step(config.law.observer, contacts, record.forces[row], dt)
    return drive, carry


def _integrated(config: ControllerConfig, integral: Array, error: Array, dt: float) -> Array:
    """Return the integral wrench one tick later, each half inside its limit."""
    c = config.law.integral
    halves = []
    for gain, limit, half in (
        (c.k_p, c.force_limit, slice(0, 3)),
        (c.k_o, c.torque_limit, slice(3, 6)),
    ):
        grown = integral[half] + gain * dt * error[half] if gain > 0.0 else np.zeros(3)
        length = float(np.linalg.norm(grown))
        halves.append(grown * min(1.0, limit / length) if length > 0.0 else grown)
    return np.concatenate(halves)
