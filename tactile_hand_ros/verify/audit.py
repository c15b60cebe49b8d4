# SPDX-License-Identifier: Apache-2.0
"""Audit: is every recorded f* the optimum of (13), every torque that of the law?

Both are worked out anew from the recorded inputs by other formulas and solvers than those of the
nodes. What they share with the nodes is the hand's kinematics, and the small filters that have a
memory: reference and load observer.

Where the hand did not drive, torques are not checked. Calls of services (grasp, reset) and live
gains are no messages, so that a bag does not hold them: ticks after one disagree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.closed_loop.scenario import Scenario
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import ControllerConfig
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.load_observer import LoadObserver
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizerConfig
from tactile_hand_ros.control.reach import check_reach
from tactile_hand_ros.control.reference import SmoothReference
from tactile_hand_ros.errors import BagError, PoseError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.verify import optimum
from tactile_hand_ros.verify.recompute import heeded_inputs, scenario_of
from tactile_hand_ros.verify.recorded_inputs import Inputs, UserCommand, read_inputs

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FORCE_TOLERANCE = 1e-6  # of residuals and of the gap
CONE_TOLERANCE = 1e-4  # that of the optimization inside cones
TORQUE_TOLERANCE = 1e-9  # N m
POSE_TOLERANCE = 1e-9  # m and rad
_SIDES, _PENALTY = 12, 5.0
_LEAST_SQUEEZE, _LEAST_SPREAD = 0.1, 1e-2  # N, 1: below, cones have no load
_COLLINEAR = 1e-3


@dataclass(frozen=True)
class Check:
    """One thing that was checked at every tick.

    Attributes:
        name: What was checked.
        ticks: Number of ticks.
        worst: Largest deviation.
        tolerance: What is allowed.
        unit: Of both.
        first: Stamp of the first tick that deviates more, ns; None if there is none.
        wrong: Number of such ticks.
    """

    name: str
    ticks: int
    worst: float
    tolerance: float
    unit: str
    first: int | None
    wrong: int

    @property
    def ok(self) -> bool:
        """Whether all ticks agree."""
        return self.wrong == 0


def audit(run: Run) -> list[Check]:
    """Audit a run whose scenario is known.

    Raises:
        BagError: If it is not known, the bag cannot be read, or the hand never had a grasp.
    """
    scenario, inputs = scenario_of(run), read_inputs(run)
    if not _grasped(inputs.record).any():
        raise BagError(
            f"{run.bag} has no tick at which all fingers touch, expected one: there is nothing to "
            "audit; record a run with a grasp."
        )
    if not all(wish.certain for wish in inputs.poses):
        inputs = heeded_inputs(run)
    hand = Hand.load(
        scenario.hand, scenario.layout, np.array(scenario.manipulation_controller.gravity)
    )
    forces = _audit_forces(scenario.force_optimizer, inputs)
    return [*forces, _audit_absence(inputs), *_audit_torques(scenario, hand, inputs)]


def _check(
    name: str, record: Record, rows: NDArray[np.intp], worst: Array, tolerance: float, unit: str
) -> Check:
    """Sum up deviations at some ticks; NaN counts as wrong."""
    wrong = np.flatnonzero(~(worst <= tolerance))
    return Check(
        name,
        len(rows),
        float(worst.max()) if len(worst) else 0.0,
        tolerance,
        unit,
        int(record.stamps[rows[wrong[0]]]) if len(wrong) else None,
        len(wrong),
    )


def _rotations(quaternions: Array) -> Array:
    """Return rotation matrices of unit quaternions (x, y, z, w), shape (..., 3, 3)."""
    x, y, z, w = np.moveaxis(
        quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0
    )
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.asarray(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))


def _spread(positions: Array) -> Array:
    """Return the ratio of the second to the first extent of contact points, shape (n,)."""
    arms = positions - positions.mean(axis=1, keepdims=True)
    extents = np.linalg.svd(arms, compute_uv=False)
    return np.asarray(extents[:, 1] / extents[:, 0])


def _grasped(record: Record) -> Flags:
    """Return at which ticks all fingers touch, and not on one line, shape (n,)."""
    grasped: Flags = np.asarray(np.isfinite(record.contact_positions).all(axis=(1, 2)))
    grasped[grasped] = _spread(record.contact_positions[grasped]) >= _COLLINEAR
    return grasped


def _heard(inputs: Inputs) -> Flags:
    """Return at which ticks touch was heard at all, shape (n,)."""
    return np.array([contacts is not None for contacts in inputs.contacts], dtype=np.bool_)


def _audit_absence(inputs: Inputs) -> Check:
    """Check that no f*, such as an old one, was given for contacts that are no grasp."""
    record = inputs.record
    rows = np.flatnonzero(_heard(inputs) & ~_grasped(record))
    given = np.isfinite(record.optimal_forces[rows]).any(axis=(1, 2))
    return _check("no f* where there is no grasp", record, rows, np.asarray(1.0 * given), 0.5, "1")


def _audit_forces(config: ForceOptimizerConfig, inputs: Inputs) -> list[Check]:
    """Check every f* that was given, and that one was given wherever there is one."""
    record = inputs.record
    rows = np.flatnonzero(_grasped(record) & inputs.heeded(record.optimal_forces))
    k = len(record.finger_names)
    positions = record.contact_positions[rows]
    rotations = _rotations(record.contact_quaternions[rows])
    weights = config.weight_vector(k)
    problem = optimum.Problem.of(positions, rotations, weights, config.minimum_normal)
    best = optimum.solve(problem)
    given = record.optimal_forces[rows].reshape(len(rows), -1)
    answered = np.isfinite(given).all(axis=1)
    wanted = np.isfinite(best.forces).all(axis=1)
    residual, gap = optimum.gaps(problem, given, best.multipliers)
    both: Flags = np.asarray(answered & wanted)
    plain, checks = both, list[Check]()
    if config.cones:
        pyramids = _pyramids(config, inputs, rows)
        known = np.array([p is not None for p in pyramids], dtype=np.bool_)
        felt: Flags = np.asarray(np.isfinite(record.forces[rows]).all(axis=(1, 2)))
        felt &= np.isfinite(record.friction[rows]).all(axis=1)
        differs: Flags = np.asarray(np.abs(given - best.forces).max(axis=1) > FORCE_TOLERANCE)
        # Without a message that the bag has lost nobody knows the cones.
        plain = both & ~(differs & (known | ~felt))
        checks = _audit_cones(problem, record, rows, given, pyramids, both, differs)
    at = np.flatnonzero(plain)
    return [
        _check("(13), optimality conditions", record, rows[at], residual[at], 1e-6, "1"),
        _check("(13), duality gap per cost", record, rows[at], gap[at], 1e-6, "1"),
        _check("f* where (13) has one", record, rows, 1.0 * (answered != wanted), 0.5, "1"),
        *checks,
    ]


def _pyramids(
    config: ForceOptimizerConfig, inputs: Inputs, rows: NDArray[np.intp]
) -> list[optimum.Pyramids | None]:
    """Return the friction pyramids at some ticks, None where load or friction is not known."""
    loads = _loads(config, inputs, rows)
    friction = config.cone_share * inputs.record.friction[rows]
    known: Flags = np.asarray(
        np.isfinite(loads).all(axis=(1, 2)) & np.isfinite(friction).all(axis=1)
    )
    return [
        optimum.Pyramids(friction[i], loads[i], _SIDES, _PENALTY) if known[i] else None
        for i in range(len(rows))
    ]


def _audit_cones(
    problem: optimum.Problem,
    record: Record,
    rows: NDArray[np.intp],
    given: Array,
    pyramids: list[optimum.Pyramids | None],
    both: Flags,
    differs: Flags,
) -> list[Check]:
    """Check f* where cones shape it, and that it is inside them where they do not."""
    shaped: Array = np.full(len(rows), np.nan)
    others = shaped.copy()
    for i, p in enumerate(pyramids):
        if p is None or not both[i]:
            continue
        if differs[i]:
            shaped[i] = optimum.cone_violation(
                problem.equal[i], problem.weights, problem.minimum, p, given[i]
            )
        else:
            others[i] = max(0.0, p.excess(given[i]))
    checks = []
    for name, worst in (
        ("(13) with cones, optimality conditions", shaped),
        ("cones that did not shape f*", others),
    ):
        at = np.flatnonzero(np.isfinite(worst))
        checks.append(_check(name, record, rows[at], worst[at], CONE_TOLERANCE, "1"))
    return checks


def _loads(config: ForceOptimizerConfig, inputs: Inputs, rows: NDArray[np.intp]) -> Array:
    """Return the smoothed load per unit of squeeze at some ticks, shape (n, k, 3)."""
    record = inputs.record
    positions = record.contact_positions[rows]
    rotations = _rotations(record.contact_quaternions[rows])
    forces = record.forces[rows]
    maps = _grasp_maps(positions)
    in_palm = np.einsum("nkij,nkj->nki", rotations, forces).reshape(len(rows), -1)
    wrench = np.einsum("nij,nj->ni", maps, in_palm)
    carried = np.einsum("nij,nj->ni", np.linalg.pinv(maps), wrench).reshape(forces.shape)
    load = np.einsum("nkij,nki->nkj", rotations, carried)
    squeeze = (forces - load)[:, :, 1].sum(axis=1)
    usable = (squeeze >= _LEAST_SQUEEZE) & (_spread(positions) >= _LEAST_SPREAD)
    losses = np.cumsum(_heard(inputs) & ~_grasped(record))
    out: Array = np.full_like(load, np.nan)
    last = -1
    for i in np.flatnonzero(usable):
        out[i] = load[i] / squeeze[i]
        # The filter forgets at ticks without a grasp.
        if last == i - 1 and last >= 0 and losses[rows[i]] == losses[rows[last]]:
            passed = 1e-9 * float(record.stamps[rows[i]] - record.stamps[rows[last]])
            out[i] = out[last] + (1.0 - np.exp(-passed / config.load_time)) * (out[i] - out[last])
        last = int(i)
    return out


def _grasp_maps(positions: Array) -> Array:
    """Return G~ about the centroid at every tick, shape (n, 6, 3k)."""
    n, k = positions.shape[:2]
    arms = positions - positions.mean(axis=1, keepdims=True)
    maps = np.zeros((n, 6, k, 3))
    maps[:, :3] = np.eye(3)[:, None, :]
    for axis in range(3):
        unit = np.eye(3)[axis]
        maps[:, 3:, :, axis] = np.cross(arms, unit).transpose(0, 2, 1)
    return np.asarray(maps.reshape(n, 6, 3 * k))


def _audit_torques(scenario: Scenario, hand: Hand, inputs: Inputs) -> list[Check]:
    """Check what the hand believed and what it answered, at all ticks at which it drove."""
    record, config = inputs.record, scenario.manipulation_controller
    drove = np.isfinite(record.auxiliary_position).all(axis=1)
    answered = np.isfinite(record.command).all(axis=1)
    known = np.isfinite(record.contact_positions).all(axis=(1, 2))
    rows = np.flatnonzero(drove & answered & known)
    name = {"optimal": "(14)", "contact": "(10)", "kawamura": "(8)"}[config.law.name]
    name = f"torque of law {name}"
    if not len(rows):
        return [_check(name, record, rows, np.zeros(0), TORQUE_TOLERANCE, "N m")]
    tips = [hand.fingertips(record.theta[row]) for row in rows]
    linear, angular = np.array([t.linear for t in tips]), np.array([t.angular for t in tips])
    centres = np.array([t.positions for t in tips])
    points = record.contact_positions[rows]
    if config.law.name == "kawamura":
        points = centres
    off = np.abs(points.mean(axis=1) - record.auxiliary_position[rows]).max(axis=1)
    law = _law_torques(config, hand, record, rows, (linear, angular, centres), inputs)
    difference = np.abs(law - record.command[rows]).max(axis=1)
    checks = [_check("centroid", record, rows, off, POSE_TOLERANCE, "m")]
    if len(record.finger_names) == 3:
        turned = _frame_errors(points, record.auxiliary_quaternion[rows])
        checks.append(_check("virtual frame", record, rows, turned, POSE_TOLERANCE, "rad"))
    checks.append(_check(name, record, rows, difference, TORQUE_TOLERANCE, "N m"))
    return checks


def _frame_errors(points: Array, quaternions: Array) -> Array:
    """Return how far the recorded frames are from those of three points, either side up."""
    frames = _rotations(quaternions)
    along, across = points[:, 0] - points[:, 1], points[:, 0] - points[:, 2]
    normal = np.cross(along, across)
    x = along / np.linalg.norm(along, axis=1, keepdims=True)
    z = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    side = np.sign((z * frames[:, :, 2]).sum(axis=1, keepdims=True))
    errors: Array = np.maximum(
        np.abs(frames[:, :, 0] - x).max(axis=1), np.abs(frames[:, :, 2] - side * z).max(axis=1)
    )
    return errors


def _law_torques(
    config: ControllerConfig,
    hand: Hand,
    record: Record,
    rows: NDArray[np.intp],
    tips: tuple[Array, Array, Array],
    inputs: Inputs,
) -> Array:
    """Return the torques of the configured law at some ticks, shape (n, m)."""
    linear, angular, centres = tips
    points, k = record.contact_positions[rows], len(record.finger_names)
    n, m = len(rows), linear.shape[-1]
    drive, carry = _wrenches(config, hand, record, rows, inputs)
    squeeze = record.grasp_force[rows][:, None, None]
    if config.law.name == "kawamura":
        pull = squeeze / hand.radii.sum() * (centres.mean(axis=1, keepdims=True) - centres)
        wrench = drive + carry
        torque = np.einsum("nkim,nki->nm", linear, pull + wrench[:, None, :3])
        attitude = wrench[:, 3:] + config.law.k_st * np.array(config.law.r_ref)
        torque += np.einsum("nkim,ni->nm", angular, attitude)
    else:
        arms = points - centres
        turning = np.cross(angular, arms[:, :, :, None], axisa=2, axisb=2, axisc=2)
        jacobian = (linear + turning).reshape(n, 3 * k, m)
        if config.law.name == "optimal":
            rotations = _rotations(record.contact_quaternions[rows])
            shape = np.einsum("nkij,nkj->nki", rotations, record.optimal_forces[rows])
        else:
            shape = points.mean(axis=1, keepdims=True) - points
        inverse = np.linalg.pinv(_grasp_maps(points))
        forces = (squeeze * shape).reshape(n, -1)
        forces += np.einsum("nij,nj->ni", inverse, drive + carry)
        torque = np.einsum("nfm,nf->nm", jacobian, forces)
    torque -= config.law.damping * record.rates[rows]
    if config.midpoint_hold:
        follows = np.flatnonzero(np.diff(_turns(inputs)[rows]) == 1) + 1
        before = torque.copy()
        torque[follows] += 0.5 * (before[follows] - before[follows - 1])
    if config.gravity_compensation:
        torque += np.array([hand.gravity_torque(record.theta[row]) for row in rows])
    return np.asarray(torque)


def _turns(inputs: Inputs) -> NDArray[np.intp]:
    """Return the place of each tick among those that the controller has heeded, shape (n,)."""
    return np.cumsum(inputs.heeded(inputs.record.command)) - 1


def _wrenches(
    config: ControllerConfig,
    hand: Hand,
    record: Record,
    rows: NDArray[np.intp],
    inputs: Inputs,
) -> tuple[Array, Array]:
    """Return what moves and what carries the object at some ticks, both of shape (n, 6)."""
    frames = _rotations(record.auxiliary_quaternion[rows])
    observer, reference = LoadObserver(), SmoothReference()
    integral = np.zeros(6)
    drive, carry = np.zeros((len(rows), 6)), np.zeros((len(rows), 6))
    target: Target | None = None
    grasp: tuple[Array, Contacts, AuxiliaryPose] | None = None
    unsaid = sorted(inputs.poses, key=lambda wish: max(wish.stamp, 0))
    queue: list[tuple[int, UserCommand, bool]] = []  # from which stamp, what, if in reach
    turns = _turns(inputs)[rows]
    for i, row in enumerate(rows):
        follows = i > 0 and turns[i - 1] == turns[i] - 1
        dt = 1e-9 * float(record.stamps[row] - record.stamps[rows[i - 1]]) if follows else 0.0
        if not follows:
            reference.reset()
        now = AuxiliaryPose(record.auxiliary_position[row], frames[i])
        target = target or Target(now.position, now.orientation)
        # As in the controller: judged by the grasp when it is said, else when it is due.
        for wish in [w for w in unsaid if w.first <= row]:
            if grasp is None or _within_reach(hand, *grasp, wish.value):
                is_ahead = not wish.first or wish.stamp > int(record.stamps[wish.first - 1])
                queue.append((wish.stamp if is_ahead else 0, wish, grasp is not None))
        unsaid = [wish for wish in unsaid if wish.first > row]
        contacts = Contacts(
            record.contact_positions[row],
            rotation_from_quaternion(record.contact_quaternions[row]),
        )
        grasp = record.theta[row], contacts, now
        queue.sort(key=lambda entry: entry[0])
        count = sum(stamp <= int(record.stamps[row]) for stamp, *_ in queue)
        if count:
            (*older, (_, wish, known)), queue = queue[:count], queue[count:]
            if known or _within_reach(hand, *grasp, wish.value):
                target = wish.value
            else:
                queue = [(0, before, judged) for _, before, judged in older] + queue
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
        if config.law.observer.time > 0.0:
            carry[i] += observer.step(config.law.observer, contacts, record.forces[row], dt)
    return drive, carry


def _within_reach(
    hand: Hand, theta: Array, contacts: Contacts, pose: AuxiliaryPose, target: Target
) -> bool:
    """Return whether the controller took a desired pose."""
    try:
        check_reach(hand, theta, contacts, pose, target)
    except PoseError:
        return False
    return True


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


COLUMNS = ("check", "ticks", "worst", "allowed", "wrong", "first")


def rows(checks: list[Check]) -> list[list[str]]:
    """Return checks as text, columns as in `COLUMNS`."""
    return [
        [
            c.name,
            str(c.ticks),
            f"{c.worst:.2g} {c.unit}",
            f"{c.tolerance:.0g}",
            str(c.wrong) if c.wrong else "none",
            "" if c.first is None else f"{1e-9 * c.first:.3f} s",
        ]
        for c in checks
    ]
