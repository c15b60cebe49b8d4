# SPDX-License-Identifier: Apache-2.0
"""Contacts: points, contact frames C_i and the hand Jacobian (2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.rotations import Vector, cross, rows_of_quaternions

if TYPE_CHECKING:  # Pinocchio loads slowly
    from tactile_hand_ros.hand.hand import Fingertips


MIN_CONTACTS = 3
"""Contacts needed to hold and turn an object (A7); a hand with two fingers holds with both."""

OFF_TIP = 1.0 / 6.0
"""Fraction of its radius by which a fingertip may miss its contact: 10 degrees around the tip."""

# A shorter projection of a unit vector on a face has no clear direction.
_MIN_PROJECTION = 1e-3


@dataclass(frozen=True)
class Contacts:
    """Contacts of the fingers, in the palm frame; a row of NaN means no contact.

    Attributes:
        positions: Contact points p_c, shape (k, 3), m.
        rotations: Contact frames R_C = [t_x, n, t_z], shape (k, 3, 3); n points into the object.
    """

    positions: Array
    rotations: Array

    @classmethod
    def from_poses(cls, positions: Array, quaternions: Array) -> Contacts:
        """Return the contacts of positions, (k, 3), m, and quaternions (x, y, z, w), (k, 4)."""
        return cls(positions, _frames(quaternions))

    @cached_property
    def touching(self) -> NDArray[np.bool_]:
        """Which fingers touch, shape (k,)."""
        return _touching(self.positions, self.rotations)

    @cached_property
    def all_touching(self) -> bool:
        """Whether all fingers touch."""
        return all(self.touching.tolist())

    @cached_property
    def enough_touching(self) -> bool:
        """Whether enough fingers touch to hold an object without the others (A7)."""
        return bool(sum(self.touching) >= min(MIN_CONTACTS, len(self.positions)))

    def part(self, chosen: NDArray[np.bool_]) -> Contacts:
        """Return the contacts of the fingers in a mask of shape (k,)."""
        return self if all(chosen) else Contacts(self.positions[chosen], self.rotations[chosen])

    def replaced(self, chosen: NDArray[np.bool_], part: Contacts) -> Contacts:
        """Return the contacts with others for the fingers in a mask of shape (k,)."""
        positions, rotations = self.positions.copy(), self.rotations.copy()
        positions[chosen], rotations[chosen] = part.positions, part.rotations
        return Contacts(positions, rotations)

    def without(self, missing: NDArray[np.bool_]) -> Contacts:
        """Return the contacts without those of the fingers in a mask of shape (k,)."""
        return Contacts(np.where(missing[:, None], np.nan, self.positions), self.rotations)

    @property
    def normals(self) -> Array:
        """Contact normals n into the object, shape (k, 3)."""
        return self.rotations[:, :, 1]

    @cached_property
    def centroid(self) -> Array:
        """Mean of the contact points, shape (3,), m; NaN when a contact is missing."""
        return centroid(self.positions)


@compiled
def all_finite(forces: Array) -> bool:
    """Return whether all numbers of an array of any shape are finite."""
    return bool(np.isfinite(forces).all())


@compiled
def centroid(points: Array) -> Array:
    """Return the mean, shape (3,), m, of points, shape (k, 3), m."""
    out = np.zeros(3)
    for i in range(len(points)):
        out += points[i]
    return out / len(points)


@compiled
def _frames(quaternions: Array) -> Array:
    """Return the contact frames, (k, 3, 3), of quaternions (x, y, z, w), (k, 4)."""
    return rows_of_quaternions(quaternions).reshape(-1, 3, 3)


@compiled
def _touching(positions: Array, rotations: Array) -> NDArray[np.bool_]:
    """Return which contacts have a finite point and frame, shape (k,)."""
    out = np.empty(len(positions), dtype=np.bool_)
    for i in range(len(positions)):
        total = 0.0  # finite only if all its terms are
        for j in range(3):
            row = rotations[i, j]
            total += positions[i, j] + row[0] + row[1] + row[2]
        out[i] = np.isfinite(total)
    return out


@compiled
def tip_gaps(tips: Fingertips, points: Array, rotations: Array, radii: Array) -> Array:
    """Return the contacts less the points p_f + r n of the fingertips, shape (k, 3), m.

    A contact lies on its fingertip, so this is what joints and touch disagree about. The radii, m,
    have the shape (k,).
    """
    out = points - tips.positions
    for i in range(len(out)):
        out[i] -= radii[i] * rotations[i, :, 1]
    return out


@compiled
def contact_frame(normal: Array) -> Array:
    """Return R_C = [t_x, n, t_z], shape (3, 3), of a unit normal n into the object, palm frame.

    t_z is palm z projected on the face, or palm x if that projection is shorter than 1e-3.
    """
    return face_frame(normal, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))


@compiled
def face_frame(normal: Array, along: Vector | Array, otherwise: Vector | Array) -> Array:
    """Return [t_x, n, t_z], shape (3, 3), with t_z along a direction projected on the face.

    `otherwise` replaces the unit vector `along` if its projection is shorter than 1e-3. All have
    the shape (3,).
    """
    nx, ny, nz = normal
    tx, ty, tz, length = 0.0, 0.0, 0.0, 0.0
    for ex, ey, ez in (along, otherwise):
        d = ex * nx + ey * ny + ez * nz
        tx, ty, tz = ex - d * nx, ey - d * ny, ez - d * nz
        length = (tx * tx + ty * ty + tz * tz) ** 0.5
        if length >= _MIN_PROJECTION:
            break
    tx, ty, tz = tx / length, ty / length, tz / length
    x0, x1, x2 = cross((nx, ny, nz), (tx, ty, tz))
    return np.array([[x0, nx, tx], [x1, ny, ty], [x2, nz, tz]])


@compiled
def hand_jacobian(tips: Fingertips, points: Array, frames: Array) -> Array:
    """Return the hand Jacobian J_h,i = [I  -p_cf^] [J; J_Omega], turned into frames: R^T J_h,i.

    It has the shape (k, 3, m): velocities of the contact points p_c, (k, 3), m, per joint rate. The
    row along an axis t of a frame is t^T J + (p_cf x t)^T J_Omega. The frames, (k, 3, 3), are
    contact frames, or identities for the paper's J_h in palm axes.

    Source: Shaw-Cortez et al., equation (2).
    """
    centers, linear, angular = tips
    k, _, m = linear.shape
    out = np.empty((k, 3, m))
    for i in range(k):
        a, b, c = points[i] - centers[i]
        for axis in range(3):
            x, y, z = frames[i, 0, axis], frames[i, 1, axis], frames[i, 2, axis]
            p, q, r = cross((a, b, c), (x, y, z))
            for j in range(m):
                out[i, axis, j] = (
                    x * linear[i, 0, j] + y * linear[i, 1, j] + z * linear[i, 2, j]
                    + p * angular[i, 0, j] + q * angular[i, 1, j] + r * angular[i, 2, j]
                )  # fmt: skip
    return out


@compiled
def in_palm(rotations: Array, forces: Array, scale: float) -> Array:
    """Return forces of contact frames, shape (k, 3), times a factor, in palm axes."""
    out = np.empty_like(forces)
    for i in range(len(forces)):
        r, f = rotations[i], forces[i]
        for j in range(3):
            out[i, j] = scale * (r[j, 0] * f[0] + r[j, 1] * f[1] + r[j, 2] * f[2])
    return out


@compiled
def in_contacts(rotations: Array, forces: Array) -> Array:
    """Return forces of palm axes, shape (k, 3), in contact frames."""
    return in_palm(rotations.transpose(0, 2, 1), forces, 1.0)


def known_part(forces: Array) -> Array:
    """Return forces in contact frames, (..., 3), N, without unknown tangential parts, NaN."""
    return np.where(np.isnan(forces) & np.isfinite(forces[..., 1:2]), 0.0, forces)


@compiled
def joint_torques(tips: Fingertips, points: Array, forces: Array) -> Array:
    """Return J_h^T f, (m,), N m, of forces f in palm axes, (k, 3), N, at contact points, (k, 3), m.

    A force f at the arm p_cf acts at the fingertip's center as f and p_cf x f.

    Source: Shaw-Cortez et al., equation (2), without forming J_h.
    """
    centers, linear, angular = tips
    out = np.zeros(linear.shape[2])
    for i in range(len(points)):
        x, y, z = forces[i]
        a, b, c = points[i] - centers[i]
        p, q, r = cross((a, b, c), (x, y, z))
        for j in range(len(out)):
            out[j] += x * linear[i, 0, j] + y * linear[i, 1, j] + z * linear[i, 2, j]
            out[j] += p * angular[i, 0, j] + q * angular[i, 1, j] + r * angular[i, 2, j]
    return out


def example_touch(fingers: int) -> tuple[Contacts, Array]:
    """Return contacts of k fingers around a cylinder, and forces in contact frames, N."""
    angles = 2.0 * np.pi * np.arange(fingers) / fingers
    outward = np.stack([np.cos(angles), np.sin(angles), np.zeros(fingers)], axis=1)
    frames = np.array([contact_frame(normal) for normal in -outward])
    return Contacts(0.05 * outward, frames), np.tile([0.0, 1.0, 0.0], (fingers, 1))
