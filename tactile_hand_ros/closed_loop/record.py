# SPDX-License-Identifier: Apache-2.0
"""A run as arrays, tick by tick; identical in-process and from a bag."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array


def _ticks(shape: str, meaning: str) -> Array:
    """Declare an array with one row per tick, given the shape of a row."""
    array: Array = field(metadata={"shape": shape, "meaning": meaning})
    return array


@dataclass(frozen=True)
class Record:
    """Time-aligned arrays of a run with n ticks, k fingers and m joints; NaN where unknown.

    Positions are in the palm frame, quaternions are (x, y, z, w). Forces act on the object and are
    in the contact frames C_i, with y along the normal.
    """

    finger_names: list[str]
    joint_names: list[str]
    stamps: NDArray[np.int64] = field(metadata={"shape": "", "meaning": "tick, ns"})
    palm: Array = _ticks("4", "orientation of the palm in the world by an IMU")
    theta: Array = _ticks("m", "joint angles, rad")
    rates: Array = _ticks("m", "joint rates, rad/s")
    torque: Array = _ticks("m", "torque applied until the tick, N m")
    command: Array = _ticks("m", "torque that answered the tick, N m")
    contact_positions: Array = _ticks("k3", "contact points by touch, m")
    contact_quaternions: Array = _ticks("k4", "contact frames by touch")
    forces: Array = _ticks("k3", "contact forces by touch, N")
    optimal_forces: Array = _ticks("k3", "f* of (13), 1")
    grasp_force: Array = _ticks("", "grasp force k_f, N")
    auxiliary_position: Array = _ticks("3", "estimated contact centroid, m")
    auxiliary_quaternion: Array = _ticks("4", "estimated virtual frame")
    desired_position: Array = _ticks("3", "p_d, m; NaN before the first command")
    desired_quaternion: Array = _ticks("4", "R_pod; NaN before the first command")
    object_position: Array = _ticks("3", "true position of the object, m")
    object_quaternion: Array = _ticks("4", "true orientation of the object")
    true_positions: Array = _ticks("k3", "true contact points, m")
    true_quaternions: Array = _ticks("k4", "true contact frames")
    true_forces: Array = _ticks("k3", "true contact forces, N")
    true_sliding: Array = _ticks("k", "true sliding speed of each contact, m/s")
    true_slid: Array = _ticks("k", "true distance each contact has slid, m")
    friction: Array = _ticks("k", "friction estimate of the regulator")
    slip_evidence: Array = _ticks("k", "evidence for slip, 1 at the alarm")
    grip: Array = _ticks("k", "state of each contact: 0 unknown, 1 stick, 2 slip")

    @classmethod
    def empty(cls, ticks: int, finger_names: list[str], joint_names: list[str]) -> Record:
        """Return a record filled with NaN."""
        sizes = {"k": len(finger_names), "m": len(joint_names), "3": 3, "4": 4}
        arrays = {
            f.name: np.full((ticks, *(sizes[s] for s in f.metadata["shape"])), np.nan)
            for f in fields(cls)
            if "shape" in f.metadata and f.name != "stamps"
        }
        return cls(finger_names, joint_names, np.zeros(ticks, dtype=np.int64), **arrays)

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.stamps)

    @property
    def times(self) -> Array:
        """Simulated time of each tick, shape (n,), s."""
        return np.asarray(1e-9 * self.stamps, dtype=np.float64)

    def part(self, ticks: slice) -> Record:
        """Return some of the ticks; arrays are views."""
        arrays = {f.name: getattr(self, f.name)[ticks] for f in fields(self) if f.metadata}
        return Record(self.finger_names, self.joint_names, **arrays)
