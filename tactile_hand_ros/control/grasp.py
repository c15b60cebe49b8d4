# SPDX-License-Identifier: Apache-2.0
"""The grasp: grasp maps (4) and (11), beta, the checks of A5 and A7, and the virtual frame."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from tactile_hand_ros.compiled import Array, compiled
from tactile_hand_ros.control.contact import centroid, face_frame
from tactile_hand_ros.errors import CollinearContactsError, GraspError
from tactile_hand_ros.rotations import cross, rodrigues

if TYPE_CHECKING:  # Pinocchio loads slowly
    from tactile_hand_ros.hand.hand import Fingertips

# Below this, contacts count as lying on a line, and the rotation about it is lost (A7). The two
# contacts of a gripper never control it, and count as spread.
MIN_COLLINEARITY_MARGIN = 1e-3

_OTHER_SIDE = np.array([1.0, -1.0, -1.0])  # flips r_y and r_z
_CLEAR_MARGIN = 0.1  # collinearity margin above which three points make a good frame
_LOOSE = 1e-9  # of the scatter, so that the turn about a line of contacts is finite


@compiled
def grasp_map(arms: Array, frames: Array) -> Array:
    """Return the grasp map G, (6, 3k), with G_i^T = [I  -d_i^], for forces along axes of frames.

    A unit force along an axis t at an arm d gives the wrench (t, d x t) on the object in palm axes.

    Args:
        arms: Contact points d from the reference point of torques, palm axes, shape (k, 3), m: from
            the object's origin, p_c,i - p_o, in (4), and from the contact centroid in (11).
        frames: Frames of the forces, shape (k, 3, 3): contact frames, or identities for palm axes.

    Source: Shaw-Cortez et al., equations (4) and (11).
    """
    out = np.empty((3 * len(arms), 6))
    for i in range(len(arms)):
        a, b, c = arms[i]
        for axis in range(3):
            x, y, z = frames[i, 0, axis], frames[i, 1, axis], frames[i, 2, axis]
            row = out[3 * i + axis]
            row[0], row[1], row[2] = x, y, z
            row[3], row[4], row[5] = cross((a, b, c), (x, y, z))
    return out.T


@compiled
def net_wrench(points: Array, rotations: Array, forces: Array) -> Array:
    """Return G~ f, the wrench of contact forces about the contact centroid, shape (6,), N and N m.

    The forces on the object are in contact frames, (k, 3), N, the points in the palm frame.

    Source: Shaw-Cortez et al., equation (11), without forming G~.
    """
    arms, out = centered(points), np.zeros(6)
    for i in range(len(points)):
        force = rotations[i] @ forces[i]
        out[:3] += force
        out[3:] += np.array(cross(arms[i], force))
    return out


@compiled
def carried_along(
    tips: Fingertips, positions: Array, frames: Array, moved: Array
) -> tuple[Array, Array]:
    """Return positions and frames of contacts after a small motion of the fingers.

    The object moves with its contacts: by the twist v of G~^T v = J_h d(theta), in least squares.
    About the centroid it turns by S^-1 sum(d_i x dp_i), see `wrench_forces`. Its faces turn, and
    the fingertips roll on them. The arguments are fingertips, contact points, (k, 3), m, and frames
    before the joint angles change by `moved`, (m,), rad.

    Source: Shaw-Cortez et al., equation (6).
    """
    centers, linear, angular = tips
    arms, turning, shifted = centered(positions), np.zeros(3), np.empty_like(positions)
    for i in range(len(arms)):
        shift, spin, d = linear[i] @ moved, angular[i] @ moved, positions[i] - centers[i]
        shifted[i] = centers[i] + shift
        turning += np.array(cross(arms[i], shift + np.array(cross(spin, d))))
    scatter = arms.T @ arms
    scatter += _LOOSE * np.trace(scatter) * np.eye(3)
    x, y, z = _solve_spread(scatter, turning)
    rotation, turned = rodrigues(x, y, z), np.empty_like(frames)
    for i in range(len(arms)):
        shifted[i] += rotation @ (positions[i] - centers[i])
        turned[i] = rotation @ frames[i]
    return shifted, turned


def wrench_forces(points: Array, wrench: Array) -> Array:
    """Return the contact forces G~^+ wrench, the smallest with a wrench, palm axes, (k, 3), N.

    G~ is the grasp map (11). About the centroid its pseudoinverse is f_i = F / k + (S^-1 T) x d_i,
    with d_i = p_c,i - centroid, S = sum(|d_i|^2 I - d_i d_i^T) and the wrench (F, T), N and N m.

    Raises:
        CollinearContactsError: If the contacts lie on a line (A7).
    """
    forces, margin = spread_wrench(points, wrench)
    if margin < MIN_COLLINEARITY_MARGIN:
        raise CollinearContactsError.of(points)
    return forces


@compiled
def spread_wrench(points: Array, wrench: Array) -> tuple[Array, float]:
    """Return the forces of `wrench_forces`, undefined on a line, and the collinearity margin."""
    arms = centered(points)
    k, margin, scatter = len(points), _margin(arms), arms.T @ arms
    if k == 2:
        scatter += _LOOSE * np.trace(scatter) * np.eye(3)
    x, y, z = _solve_spread(scatter, wrench[3:])
    out = np.empty((k, 3))
    for i in range(k):
        a, b, c = arms[i]
        out[i, 0] = wrench[0] / k + y * c - z * b
        out[i, 1] = wrench[1] / k + z * a - x * c
        out[i, 2] = wrench[2] / k + x * b - y * a
    return out, margin


@compiled
def _solve_spread(scatter: Array, right: Array) -> tuple[float, float, float]:
    """Solve (trace(scatter) I - scatter) w = right by its adjugate."""
    xx, xy, xz = scatter[0]
    yy, yz, zz = scatter[1, 1], scatter[1, 2], scatter[2, 2]
    x, y, z = right
    a, b, c, d, e, f = yy + zz, -xy, -xz, xx + zz, -yz, xx + yy
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / (a * aa + b * ab + c * ac)
    return (
        scale * (aa * x + ab * y + ac * z),
        scale * (ab * x + bb * y + bc * z),
        scale * (ac * x + bc * y + cc * z),
    )


@compiled
def centered(points: Array) -> Array:
    """Return the arms p_c,i - centroid of points p_c, both of shape (k, 3), m."""
    return points - centroid(points)


@compiled
def collinearity_margin(points: Array) -> float:
    """Return the margin of assumption A7: 0 for contacts on a line, 1 for an even spread.

    It is the ratio of the second to the first singular value of p_c,i - centroid of points of shape
    (k, 3), m, and 1 for two contacts, which no third one has to complete.
    """
    return _margin(centered(points))


@compiled
def _margin(arms: Array) -> float:
    if len(arms) == 2:
        return 1.0
    if len(arms) == 3:
        # l1 l2 of the scatter is three times the squared cross product of two arms, and l1 + l2 is
        # the sum of the squared arms.
        total = (arms * arms).sum()
        nx, ny, nz = cross(arms[0], arms[1])
        product = 3.0 * (nx * nx + ny * ny + nz * nz)
        largest = 0.5 * (total + math.sqrt(max(total * total - 4.0 * product, 0.0)))
        return math.sqrt(product) / largest if largest > 0.0 else 0.0
    squares = np.linalg.eigvalsh(arms.T @ arms)
    return math.sqrt(max(squares[1], 0.0) / squares[2]) if squares[2] > 0.0 else 0.0


def joint_margin(hand_jacobian: Array) -> float:
    """Return the margin of assumption A5: the smallest singular value of J_h, in m/rad.

    J_h has the shape (3k, m) or (k, 3, m). Directions in which a finger cannot move, for want of
    joints, do not count.
    """
    joints = hand_jacobian.shape[-1]
    stacked = hand_jacobian.reshape(-1, joints)
    moved = stacked.reshape(-1, 3, joints).any(axis=1)
    rank = min(np.minimum(moved.sum(axis=1), 3).sum(), moved.any(axis=0).sum())
    return float(np.linalg.svd(stacked, compute_uv=False)[rank - 1]) if rank else 0.0


def check_joints(hand_jacobian: Array, minimum: float = 1e-3) -> None:
    """Check assumption A5: J_h has full row rank, as far as the number of joints allows.

    J_h has the shape (3k, m) or (k, 3, m), and `minimum` is in m/rad.

    Raises:
        GraspError: If the hand cannot move its contact points freely.
    """
    margin = joint_margin(hand_jacobian)
    if margin < minimum:
        rows = hand_jacobian.size // hand_jacobian.shape[-1]
        raise GraspError(
            f"the hand is singular (A5): the smallest singular value of J_h ({rows} x "
            f"{hand_jacobian.shape[-1]}) is {margin:.2g} m/rad, at least {minimum:.2g} is needed; "
            "bend the fingers"
        )


def check_spread(points: Array) -> None:
    """Check assumption A7: points, shape (k, 3), m, that are not on one line, or two.

    Raises:
        CollinearContactsError: If they are.
    """
    if collinearity_margin(points) < MIN_COLLINEARITY_MARGIN:
        raise CollinearContactsError.of(points)


def required_friction(forces: Array) -> Array:
    """Return beta_i = sqrt(f_x^2 + f_z^2) / f_n, the friction coefficient that each contact needs.

    Forces in C_i have the shape (k, 3), N. The result of shape (k,) is infinite for a tangential
    force without a normal force, and 0 without a force.
    """
    tangential, normal = np.hypot(forces[..., 0], forces[..., 2]), forces[..., 1]
    beta = np.where(tangential == 0.0, 0.0, np.inf)
    return np.divide(tangential, normal, out=beta, where=normal > 0.0)


class VirtualFrame:
    """Follows the orientation of a grasp from its contact points.

    For three contacts r_x points from contact 2 to contact 1, r_z is normal to their plane, and
    r_y = r_z x r_x. At the start r_z is on the side of palm +z; it then keeps its side, so that a
    grasp can turn upside down. For more contacts the frame of the first three at the start (or of
    the three farthest from a line) turns with the best rotation of all contacts (Kabsch 1976).
    For two contacts r_z turns with r_x alone, since they do not show a turn about their line.

    Source: Shaw-Cortez et al., section III; our generalization for k > 3 and k = 2.
    """

    def __init__(self) -> None:
        """Start without a grasp."""
        self._side = 0.0
        self._up = np.array([0.0, 0.0, 1.0])  # the last r_z of two contacts
        self._start: tuple[Array, Array] | None = None

    def orientation(self, points: Array) -> Array:
        """Return R_pov = [r_x r_y r_z], (3, 3), of contact points, (k, 3), m, in the palm frame.

        Raises:
            CollinearContactsError: If three contacts or more lie on a line.
        """
        if len(points) == 2:
            return self._line_frame(points)
        check_spread(points)
        if len(points) == 3:
            return self._plane_frame(points)
        arms = centered(points)
        if self._start is None:
            self._start = arms, self._plane_frame(_leading(points))
        before, frame = self._start
        return best_rotation(before, arms) @ frame

    def _line_frame(self, points: Array) -> Array:
        along = points[0] - points[1]
        along = along / np.linalg.norm(along)
        frame = face_frame(along, self._up, np.array([1.0, 0.0, 0.0]))
        self._up = frame[:, 2].copy()
        return np.column_stack([along, -frame[:, 0], self._up])

    def _plane_frame(self, points: Array) -> Array:
        frame = _frame_of_plane(points)
        if self._side == 0.0:
            self._side = -1.0 if frame[2, 2] < 0.0 else 1.0
        return frame if self._side > 0.0 else frame * _OTHER_SIDE


def _leading(points: Array) -> Array:
    """Return the first three points, or the three farthest from a line if those are near one."""
    if collinearity_margin(points[:3]) >= _CLEAR_MARGIN:
        return points[:3]
    triples = (points[list(three)] for three in combinations(range(len(points)), 3))
    return max(triples, key=collinearity_margin)


@compiled
def pose_error(position: Array, actual: Array, wanted: Array, desired: Array) -> Array:
    """Return p_d - p, m, and r_d = sum over the axes of r x r_desired, shape (6,).

    r_d is 2 sin(angle) times the axis of the rotation from R_pov to R_pod, in palm axes. The
    arguments are p, R_pov, p_d and R_pod.

    Source: Shaw-Cortez et al., below equation (8).
    """
    out = np.zeros(6)
    out[:3] = wanted - position
    for axis in range(3):
        out[3:] += np.array(cross(actual[:, axis], desired[:, axis]))
    return out


@compiled
def _frame_of_plane(points: Array) -> Array:
    """Return [r_x r_y r_z] of three points; r_z is along (p_1 - p_2) x (p_1 - p_3)."""
    a, b, c = points[0] - points[1]
    d, e, f = points[0] - points[2]
    length = math.sqrt(a * a + b * b + c * c)
    x0, x1, x2 = a / length, b / length, c / length
    u, v, w = cross((a, b, c), (d, e, f))
    length = math.sqrt(u * u + v * v + w * w)
    z0, z1, z2 = u / length, v / length, w / length
    y0, y1, y2 = cross((z0, z1, z2), (x0, x1, x2))
    return np.array([[x0, y0, z0], [x1, y1, z1], [x2, y2, z2]])


@compiled
def best_rotation(before: Array, after: Array) -> Array:
    """Return the rotation, (3, 3), that best maps centered points, (k, 3), m, to their images.

    Source: Kabsch 1976; of a reflection the direction of the smallest extent is reversed.
    """
    u, _, vt = np.linalg.svd(after.T @ before)
    product: Array = u @ vt
    if np.linalg.det(product) < 0.0:
        u[:, 2] *= -1.0
        product = u @ vt
    return product
