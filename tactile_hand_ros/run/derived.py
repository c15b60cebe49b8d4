# SPDX-License-Identifier: Apache-2.0
"""Quantities derived from a record: errors, friction, motion in the grasp, gaps, drops."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control import grasp
from tactile_hand_ros.rotations import rotation_from_quaternion
from tactile_hand_ros.scenario.link_collisions import LinkCollisions

_LOOK = 0.05  # s between two looks at links in the object
LONG = 5  # missing ticks that count as a gap; in real time, a late plant skips a few
_HOLDING = 2  # minimum number of fingers that can hold an object


def silent(record: Record) -> NDArray[np.bool_]:
    """Return the ticks at which all touch messages are missing, shape (n,).

    A hand that has lost all contacts is different: it reports no positions, and forces of zero.
    """
    missing = np.isnan(record.contact_positions[:, :, 0]).all(axis=1)
    forces = record.forces[:, :, 1]
    return np.asarray(missing & (np.isnan(forces).all(axis=1) | (forces > 0.0).any(axis=1)))


def spans(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first row and row after the last of each stretch in which flags are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def gaps(record: Record) -> list[tuple[int, int]]:
    """Return the recorded rows before and after each stretch of missing ticks or touch messages."""
    if len(record) < 3:
        return []
    steps = np.diff(record.stamps)
    period = float(np.median(steps))
    found = [(int(row), int(row) + 1) for row in np.flatnonzero(steps > LONG * period)]
    quiet = silent(record)
    if quiet.all():  # without touch altogether
        return found
    for start, end in spans(quiet):
        if end - start >= LONG:
            found.append((max(0, start - 1), min(end, len(record) - 1)))
    return sorted(found)


def dropped_at(record: Record, releases: Sequence[float] = ()) -> float:
    """Return when the object was dropped, s; NaN if it is held at the end, or was never held.

    From the drop on, fewer than two fingers touch until the end of the run, by the ground truth
    where there is one: a skin may fail. An object that a user has released, at `releases` in s,
    does not count as dropped.
    """
    is_true = np.asarray(np.isfinite(record.true_forces).any(axis=(1, 2)))  # 0 without contact
    points = np.where(is_true[:, None, None], record.true_positions, record.contact_positions)
    missing = np.isnan(points[:, :, 0])
    known = np.flatnonzero(is_true | ~silent(record))  # the other ticks were not recorded
    held = np.flatnonzero((~missing[known]).sum(axis=1) >= _HOLDING)
    if not len(held) or held[-1] + 1 == len(known):
        return math.nan
    time = float(record.times[known[held[-1] + 1]])
    return math.nan if any(release <= time for release in releases) else time


def rotation_error(record: Record) -> Array:
    """Return r_d of every tick, shape (n, 3), 2 sin(angle) times the axis, palm axes.

    Source: Shaw-Cortez et al., below equation (8).
    """
    desired = _or_start(record.desired_quaternion, record.auxiliary_quaternion)
    return rotation_between(desired, record.auxiliary_quaternion)


def rotation_between(desired: Array, actual: Array) -> Array:
    """Return r_d, as in `rotation_error`, between quaternions of shape (n, 4)."""
    turn = rotation_from_quaternion(desired) @ np.swapaxes(rotation_from_quaternion(actual), 1, 2)
    skew = turn - np.swapaxes(turn, 1, 2)
    return np.asarray(skew[:, (2, 0, 1), (1, 2, 0)])


def pose_errors(record: Record, dropped: float) -> tuple[Array, Array]:
    """Return |p_d - p| in m and |r_d| at every tick, shape (n,); NaN from `dropped`, s, on.

    They are also NaN while the hand has no estimate of p. Before the first command the desired
    pose is the initial grasp, as in the controller.
    """
    desired = _or_start(record.desired_position, record.auxiliary_position)
    position = np.linalg.norm(desired - record.auxiliary_position, axis=1)
    rotation = np.linalg.norm(rotation_error(record), axis=1)
    gone = record.times >= dropped
    position[gone] = rotation[gone] = np.nan
    return position, rotation


def _or_start(desired: Array, actual: Array) -> Array:
    known = np.flatnonzero(np.isfinite(actual).all(axis=1))
    if not len(known):
        return desired
    return np.where(np.isnan(desired), actual[known[0]], desired)


def contact_forces(record: Record) -> Array:
    """Return the contact forces by touch, or the true ones if there was no touch, (n, k, 3)."""
    return record.true_forces if np.isnan(record.forces).all() else record.forces


def required_friction(record: Record) -> Array:
    """Return beta of every contact, shape (n, k), NaN without contact."""
    forces = contact_forces(record)
    unknown = np.isnan(record.contact_positions[:, :, 0]) | np.isnan(forces).any(axis=2)
    return np.where(unknown, np.nan, grasp.required_friction(forces))


def expected_normal_forces(record: Record) -> Array:
    """Return k_f f*_n of every contact, shape (n, k), N: the normal forces by (15)."""
    return np.asarray(record.grasp_force[:, None] * record.optimal_forces[:, :, 1])


def motion_in_grasp(record: Record) -> tuple[Array, Array]:
    """Return how far the true object moved and turned in the grasp, (n,) m and (n,) rad.

    The grasp is the virtual frame at the contact centroid. The motion counts from the first tick at
    which both poses are known. NaN without ground truth.
    """
    grasp = rotation_from_quaternion(record.auxiliary_quaternion)
    apart = record.object_position - record.auxiliary_position
    place = np.einsum("nji,nj->ni", grasp, apart)
    turn = np.swapaxes(grasp, 1, 2) @ rotation_from_quaternion(record.object_quaternion)
    known = np.flatnonzero(np.isfinite(place).all(axis=1) & np.isfinite(turn).all(axis=(1, 2)))
    if not len(known):
        return np.full(len(record), np.nan), np.full(len(record), np.nan)
    first = known[0]
    moved = np.linalg.norm(place - place[first], axis=1)
    # The chord of a rotation is exact for small angles, where the arc cosine of a trace is not.
    chord = np.linalg.norm(turn - turn[first], axis=(1, 2)) / np.sqrt(8.0)
    return moved, 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))


def link_inside(record: Record, links: LinkCollisions) -> tuple[str, float]:
    """Return which link first came inside the true object, and when, s; empty and NaN if none did.

    Poses are compared every 50 ms.
    """
    needed = record.theta, record.object_position, record.object_quaternion
    known = np.flatnonzero(np.isfinite(np.hstack(needed)).all(axis=1))
    looks = np.diff(np.floor(record.times[known] / _LOOK), prepend=-1.0) > 0.0
    for row in known[looks]:
        turn = rotation_from_quaternion(record.object_quaternion[row])
        found = links.touching(record.theta[row], record.object_position[row], turn)
        if found:
            return found[0], float(record.times[row])
    return "", math.nan


def rolling(record: Record) -> Array:
    """Return how far each true contact moved over the object's surface, shape (n, k), m."""
    turn = rotation_from_quaternion(record.object_quaternion)
    arms = record.true_positions - record.object_position[:, None, :]
    on_object = np.einsum("nji,nkj->nki", turn, arms)
    known = np.flatnonzero(np.isfinite(on_object).all(axis=(1, 2)))
    if not len(known):
        return np.full(arms.shape[:2], np.nan)
    return np.asarray(np.linalg.norm(on_object - on_object[known[0]], axis=2))
