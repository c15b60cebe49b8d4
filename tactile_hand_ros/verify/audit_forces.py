# SPDX-License-Identifier: Apache-2.0
"""Does every recorded f* follow from the optimum of (13), with and without friction cones?"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros import names
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizerConfig
from tactile_hand_ros.verify import optimum
from tactile_hand_ros.verify.checks import Check, check, merged
from tactile_hand_ros.verify.recorded_inputs import Inputs, in_force
from tactile_hand_ros.verify.shapes import grasp_maps, rotations, spread

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CONES = "(13) with cones, f* on its way to the optimum"
_EXACT = 1e-6  # of residuals, of the gap and of the balance
_CONE_TOLERANCE = 1e-4  # of f*; the optimization inside cones is as accurate
_SIDES, _PENALTY = 12, 5.0
_LEAST_SQUEEZE, _LEAST_SPREAD = 0.1, 1e-2  # N, 1: below, cones have no load
_COLLINEAR = 1e-3


def grasped(record: Record) -> Flags:
    """Return at which ticks all fingers touch, and not on one line, shape (n,)."""
    grasped: Flags = np.asarray(np.isfinite(record.contact_positions).all(axis=(1, 2)))
    grasped[grasped] = spread(record.contact_positions[grasped]) >= _COLLINEAR
    return grasped


def sensed(inputs: Inputs) -> Flags:
    """Return the ticks with a message of the contacts, shape (n,)."""
    return np.array([contacts is not None for contacts in inputs.contacts], dtype=np.bool_)


def audit_absence(inputs: Inputs) -> Check:
    """Check that no f*, such as an old one, was given for contacts that are no grasp."""
    record = inputs.record
    rows = np.flatnonzero(sensed(inputs) & ~grasped(record))
    given = np.isfinite(record.optimal_forces[rows]).any(axis=(1, 2))
    return check("no f* where there is no grasp", record, rows, np.asarray(1.0 * given), 0.5, "1")


def audit_forces(inputs: Inputs) -> list[Check]:
    """Check every f* that was given, and that one was given wherever there is one."""
    record = inputs.record
    rows = np.flatnonzero(grasped(record) & inputs.answered(record.optimal_forces))
    configs = in_force(inputs.configurations[names.OPTIMIZER], record.stamps)
    grasps = _grasps(configs, inputs, rows) if configs[0].cones else [None] * len(rows)
    checks = []
    for config in {id(config): config for config in configs}.values():
        part = np.array([configs[row] is config for row in rows], dtype=np.bool_)
        checks += _audit_forces_with(
            config, inputs, rows[part], [g for g, own in zip(grasps, part, strict=True) if own]
        )
    return merged(checks)


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
    frames = rotations(record.contact_quaternions[rows])
    weights = config.weight_vector(k)
    problem = optimum.Problem.of(positions, frames, weights, config.minimum_normal)
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
        check(
            "f* in balance, sum of normals 1",
            record,
            rows[every],
            unbalanced,
            _EXACT,
            "1",
        ),
        check("(13), optimality conditions", record, rows[at], residual[at], _EXACT, "1"),
        check("(13), duality gap per cost", record, rows[at], gap[at], _EXACT, "1"),
        check("f* where (13) has one", record, rows, 1.0 * (answered != wanted), 0.5, "1"),
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
    return [check(CONES, record, where, np.array(off), _CONE_TOLERANCE, "1")]


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
    load, squeeze = _loads(positions, rotations(record.contact_quaternions[rows]), forces)
    usable = (squeeze >= _LEAST_SQUEEZE) & (spread(positions) >= _LEAST_SPREAD)
    losses = np.cumsum(sensed(inputs) & ~grasped(record))
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
    maps = grasp_maps(positions)
    in_palm = np.einsum("nkij,nkj->nki", rotations, forces).reshape(len(forces), -1)
    wrench = np.einsum("nij,nj->ni", maps, in_palm)
    carried = np.einsum("nij,nj->ni", np.linalg.pinv(maps), wrench).reshape(forces.shape)
    load = np.einsum("nkij,nki->nkj", rotations, carried)
    return load, (forces - load)[:, :, 1].sum(axis=1)
