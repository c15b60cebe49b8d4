# SPDX-License-Identifier: Apache-2.0
"""Audit: does every recorded f* follow from the optimum of (13), every torque from the law?

Both are computed again from the recorded inputs, by other formulas and solvers than those of the
nodes. What they share with the nodes is the hand's kinematics, and the small filters that have a
memory: reference and load observer. Grasp map and hand Jacobian are independent on purpose: a
mistake in those that the nodes run would otherwise be made twice and look right. Poses, live gains
and calls of `~/reset` and `~/grasp` count from the ticks at which the nodes published that they
took effect.

Where the hand did not drive, torques are not checked.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import ControllerConfig
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.load_observer import LoadObserver
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizerConfig
from tactile_hand_ros.control.reference import SmoothReference
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.verify import optimum
from tactile_hand_ros.verify.recompute import scenario_of
from tactile_hand_ros.verify.recorded_inputs import (
    Effects,
    Inputs,
    Request,
    in_force,
    read_inputs,
)

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FORCE_TOLERANCE = 1e-6  # of residuals, of the gap and of the balance
CONE_TOLERANCE = 1e-4  # of f*; the optimization inside cones is as accurate
TORQUE_TOLERANCE = 1e-9  # N m
POSE_TOLERANCE = 1e-9  # m and rad
CONES = "(13) with cones, f* on its way to the optimum"
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
    scenario = scenario_of(run)
    inputs = read_inputs(run, scenario)
    if not _grasped(inputs.record).any():
        raise BagError(
            f"{run.bag} has no tick at which all fingers touch, expected one: there is nothing to "
            "audit; record a run with a grasp."
        )
    hand = Hand.load(
        scenario.hand, scenario.layout, np.array(scenario.manipulation_controller.gravity)
    )
    return [*_audit_forces(inputs), _audit_absence(inputs), *_audit_torques(hand, inputs)]


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
    return np.ascontiguousarray(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))


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


def _sensed(inputs: Inputs) -> Flags:
    """Return the ticks with a message of the contacts, shape (n,)."""
    return np.array([contacts is not None for contacts in inputs.contacts], dtype=np.bool_)


def _audit_absence(inputs: Inputs) -> Check:
    """Check that no f*, such as an old one, was given for contacts that are no grasp."""
    record = inputs.record
    rows = np.flatnonzero(_sensed(inputs) & ~_grasped(record))
    given = np.isfinite(record.optimal_forces[rows]).any(axis=(1, 2))
    return _check("no f* where there is no grasp", record, rows, np.asarray(1.0 * given), 0.5, "1")


def _audit_forces(inputs: Inputs) -> list[Check]:
    """Check every f* that was given, and that one was given wherever there is one."""
    record = inputs.record
    rows = np.flatnonzero(_grasped(record) & inputs.answered(record.optimal_forces))
    configs = in_force(inputs.configurations[names.OPTIMIZER], record.stamps)
    grasps = _grasps(configs, inputs, rows) if configs[0].cones else [None] * len(rows)
    checks = []
    for config in {id(config): config for config in configs}.values():
        part = np.array([configs[row] is config for row in rows], dtype=np.bool_)
        checks += _audit_forces_with(
            config, inputs, rows[part], [g for g, own in zip(grasps, part, strict=True) if own]
        )
    return _merged(checks)


def _merged(checks: list[Check]) -> list[Check]:
    """Join the checks of one name, made at different ticks."""
    merged: dict[str, Check] = {}
    for check in checks:
        other = merged.setdefault(check.name, check)
        if other is not check:
            first = min((c.first for c in (other, check) if c.first is not None), default=None)
            merged[check.name] = replace(
                other,
                ticks=other.ticks + check.ticks,
                worst=float(np.maximum(other.worst, check.worst)),  # NaN if either is
                first=first,
                wrong=other.wrong + check.wrong,
            )
    return list(merged.values())


def _audit_forces_with(
    config: ForceOptimizerConfig,
    inputs: Inputs,
    rows: NDArray[np.intp],
    grasps: list[_Grasp | None],
) -> list[Check]:
    """Check f* at the ticks of one configuration; `grasps` are from `_grasps`."""
    record = inputs.record
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
        known = np.array([grasp is not None for grasp in grasps], dtype=np.bool_)
        felt: Flags = np.asarray(np.isfinite(record.forces[rows]).all(axis=(1, 2)))
        felt &= np.isfinite(record.friction[rows]).all(axis=1)
        # The cones are unknown where the bag has lost a message.
        plain = both & ~known & felt
        checks = _audit_cones(config, problem, record, rows, best.forces, both, grasps)
    at, every = np.flatnonzero(plain), np.flatnonzero(both)
    unbalanced = optimum.imbalance(problem.part(every), given[every])
    return [
        _check(
            "f* in balance, sum of normals 1", record, rows[every], unbalanced, FORCE_TOLERANCE, "1"
        ),
        _check("(13), optimality conditions", record, rows[at], residual[at], FORCE_TOLERANCE, "1"),
        _check("(13), duality gap per cost", record, rows[at], gap[at], FORCE_TOLERANCE, "1"),
        _check("f* where (13) has one", record, rows, 1.0 * (answered != wanted), 0.5, "1"),
        *checks,
    ]


def _audit_cones(
    config: ForceOptimizerConfig,
    problem: optimum.Problem,
    record: Record,
    rows: NDArray[np.intp],
    plain: Array,
    both: Flags,
    grasps: list[_Grasp | None],
) -> list[Check]:
    """Check that f* goes its way from that of the tick before to the optimum inside the cones."""
    at, off = [], []
    for i, grasp in enumerate(grasps):
        if grasp is None or not both[i]:
            continue
        friction = record.friction[rows[i]]
        equal, goal = problem.equal[i], plain[i]
        usable = config.cone_share * friction
        inside = optimum.Pyramids(usable, grasp.wanted, _PENALTY)
        if inside.excess(goal) > 0.0:
            goal = optimum.solve_inside(equal, problem.weights, problem.minimum, inside)
        if grasp.before is not None and config.shape_time > 0.0:
            learned = optimum.Pyramids.about(friction, grasp.load, _SIDES, _PENALTY)
            share = 1.0 - np.exp(-grasp.elapsed / config.shape_time)
            goal = optimum.follow(grasp.before, goal, equal, learned, share)
        at.append(i)
        off.append(np.abs(record.optimal_forces[rows[i]].ravel() - goal).max())
    where = rows[np.array(at, dtype=np.intp)]
    return [_check(CONES, record, where, np.array(off), CONE_TOLERANCE, "1")]


class _Grasp(NamedTuple):
    """What the cones at a tick follow from.

    Attributes:
        load: Smoothed load per unit of squeeze, shape (k, 3).
        wanted: How far the worst load of the recent past reaches beyond each side of the pyramids,
            with the reserve, and for less squeeze, shape (k, sides).
        before: f* from which that of this tick goes on, shape (3k,); None where it starts over.
        elapsed: Time since then, s.
    """

    load: Array
    wanted: Array
    before: Array | None
    elapsed: float


def _grasps(
    configs: list[ForceOptimizerConfig], inputs: Inputs, rows: NDArray[np.intp]
) -> list[_Grasp | None]:
    """Return what the cones at some ticks follow from, None where load or friction is not known."""
    record = inputs.record
    positions, forces, friction = (
        record.contact_positions[rows],
        record.forces[rows],
        record.friction[rows],
    )
    load, squeeze = _loads(positions, _rotations(record.contact_quaternions[rows]), forces)
    usable = (squeeze >= _LEAST_SQUEEZE) & (_spread(positions) >= _LEAST_SPREAD)
    losses = np.cumsum(_sensed(inputs) & ~_grasped(record))
    found: list[_Grasp | None] = [None] * len(rows)
    smooth, largest, last = load[:0], np.zeros(load.shape[1]), -1
    worst: Array | None = None
    for i in np.flatnonzero(usable):
        config, elapsed, before = configs[rows[i]], 0.0, None
        per_squeeze = load[i] / squeeze[i]
        # The filters start over after ticks without a grasp.
        if last == i - 1 and last >= 0 and losses[rows[i]] == losses[rows[last]]:
            elapsed = 1e-9 * float(record.stamps[rows[i]] - record.stamps[rows[last]])
            share = 1.0 - np.exp(-elapsed / config.load_time)
            per_squeeze = smooth + share * (per_squeeze - smooth)
            previous = record.optimal_forces[rows[last]].ravel()
            if config is configs[rows[last]] and np.isfinite(previous).all():
                before = previous
        else:
            worst = None
        smooth, last = per_squeeze, int(i)
        keep = np.exp(-elapsed / config.reserve.memory)
        largest = np.maximum(keep * largest, np.linalg.norm(load[i], axis=1))
        if not np.isfinite(friction[i]).all():
            continue
        usable_friction = config.cone_share * friction[i]
        pyramids = optimum.Pyramids.about(
            usable_friction, squeeze[i] * per_squeeze, _SIDES, _PENALTY
        )
        now = pyramids.bounds
        if worst is not None:
            fade = np.exp(-elapsed / config.load_memory)
            now = np.maximum(now, now + fade * (worst - now))
        worst = now
        wanted = _with_reserve(config, worst, largest, usable_friction)
        wanted = wanted / (config.squeeze_share * squeeze[i])
        found[i] = _Grasp(per_squeeze, wanted, before, elapsed)
    return found


def _with_reserve(
    config: ForceOptimizerConfig, worst: Array, largest: Array, friction: Array
) -> Array:
    """Return how far loads reach beyond the pyramids with the reserve, shape (k, sides), N."""
    reserve = config.reserve
    radii = np.maximum(reserve.floor / len(worst), reserve.share * largest)
    slope = np.cos(np.pi / _SIDES) * friction
    return np.asarray(worst + (slope * radii * np.hypot(1.0, 1.0 / friction))[:, None])


def _loads(positions: Array, rotations: Array, forces: Array) -> tuple[Array, Array]:
    """Return load, shape (n, k, 3), and squeeze, shape (n,), of forces in contact frames, N."""
    maps = _grasp_maps(positions)
    in_palm = np.einsum("nkij,nkj->nki", rotations, forces).reshape(len(forces), -1)
    wrench = np.einsum("nij,nj->ni", maps, in_palm)
    carried = np.einsum("nij,nj->ni", np.linalg.pinv(maps), wrench).reshape(forces.shape)
    load = np.einsum("nkij,nki->nkj", rotations, carried)
    return load, (forces - load)[:, :, 1].sum(axis=1)


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


_TORQUE_CHECKS = {
    "optimal": "torque of law (14)",
    "contact": "torque of law (10)",
    "kawamura": "torque of law (8)",
}


def _audit_torques(hand: Hand, inputs: Inputs) -> list[Check]:
    """Check what the hand believed and what it answered, at all ticks at which it drove."""
    record = inputs.record
    law = inputs.configurations[names.CONTROLLER][0].value.law.name  # it is not live
    drove = np.isfinite(record.auxiliary_position).all(axis=1)
    answered = np.isfinite(record.command).all(axis=1)
    known = np.isfinite(record.contact_positions).all(axis=(1, 2))
    rows = np.flatnonzero(drove & answered & known)
    name = _TORQUE_CHECKS.get(law, f"torque of {law}: not known to the audit")
    if not len(rows):
        return [_check(name, record, rows, np.zeros(0), TORQUE_TOLERANCE, "N m")]
    tips = [hand.fingertips(record.theta[row]) for row in rows]
    linear, angular = np.array([t.linear for t in tips]), np.array([t.angular for t in tips])
    centres = np.array([t.positions for t in tips])
    points = record.contact_positions[rows]
    if law == "kawamura":
        points = centres
    off = np.abs(points.mean(axis=1) - record.auxiliary_position[rows]).max(axis=1)
    checks = [_check("centroid", record, rows, off, POSE_TOLERANCE, "m")]
    if len(record.finger_names) == 3:
        turned = _frame_errors(points, record.auxiliary_quaternion[rows])
        checks.append(_check("virtual frame", record, rows, turned, POSE_TOLERANCE, "rad"))
    if law not in _TORQUE_CHECKS:
        return [*checks, _check(name, record, rows[:0], np.zeros(0), TORQUE_TOLERANCE, "N m")]
    torques = _law_torques(law, hand, rows, (linear, angular, centres), inputs)
    difference = np.abs(torques - record.command[rows]).max(axis=1)
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
    law: str,
    hand: Hand,
    rows: NDArray[np.intp],
    tips: tuple[Array, Array, Array],
    inputs: Inputs,
) -> Array:
    """Return the torques of a law at some ticks, shape (n, m)."""
    linear, angular, centres = tips
    record = inputs.record
    configs = in_force(inputs.configurations[names.CONTROLLER], record.stamps[rows])
    points, k = record.contact_positions[rows], len(record.finger_names)
    n, m = len(rows), linear.shape[-1]
    renewed = _renewed(inputs, rows)
    follows = np.append(False, np.diff(_turns(inputs)[rows]) == 1) & ~renewed
    drive, carry = _wrenches(configs, rows, inputs, follows, renewed)
    squeeze = record.grasp_force[rows][:, None, None]
    wrench = drive + carry
    if law == "kawamura":
        pull = squeeze / hand.radii.sum() * (centres.mean(axis=1, keepdims=True) - centres)
        grip = np.einsum("nkim,nki->nm", linear, pull)
        attitude = np.array([c.law.k_st * np.array(c.law.r_ref) for c in configs])
        grip += np.einsum("nkim,ni->nm", angular, attitude)
        rest = np.einsum("nkim,ni->nm", linear, wrench[:, :3])
        rest += np.einsum("nkim,ni->nm", angular, wrench[:, 3:])
    else:
        arms = points - centres
        turning = np.cross(angular, arms[:, :, :, None], axisa=2, axisb=2, axisc=2)
        jacobian = (linear + turning).reshape(n, 3 * k, m)
        if law == "optimal":
            rotations = _rotations(record.contact_quaternions[rows])
            shape = np.einsum("nkij,nkj->nki", rotations, record.optimal_forces[rows])
        else:
            shape = points.mean(axis=1, keepdims=True) - points
        inverse = np.linalg.pinv(_grasp_maps(points))
        grip = np.einsum("nfm,nf->nm", jacobian, (squeeze * shape).reshape(n, -1))
        rest = np.einsum("nfm,nf->nm", jacobian, np.einsum("nij,nj->ni", inverse, wrench))
    rest -= np.array([[c.law.damping] for c in configs]) * record.rates[rows]
    torque = np.empty((n, m))
    weights = np.zeros((n, m))
    for i, config in enumerate(configs):
        if config.gravity_compensation:
            weights[i] = hand.gravity_torque(record.theta[rows[i]])
        torque[i] = rest[i] + _borne(grip[i], rest[i] + weights[i], hand.effort_limits)
    before = torque.copy()
    for i, config in enumerate(configs):
        if config.midpoint_hold and follows[i]:
            torque[i] += 0.5 * (before[i] - before[i - 1])
    return np.asarray(torque + weights)


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
    frames = _rotations(record.auxiliary_quaternion[rows])
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
