# SPDX-License-Identifier: Apache-2.0
"""Grasps to test with: the paper's two layouts and random ones."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from support.equations import grasp_map
from tactile_hand_ros.control.contact import Contacts, contact_frame
from tactile_hand_ros.control.grasp import collinearity_margin

Array = NDArray[np.float64]

HALF = 0.1302  # half an edge of the paper's cube, m
FORCES = np.array([[0.3, 4.0, -0.2], [0.1, 2.5, 0.6], [-0.4, 3.0, 0.5]])
"""Asymmetric forces of three fingers in contact frames, N."""


def contacts_at(points: Array, normals: Array) -> Contacts:
    """Return contacts whose frames follow the convention of the palm frame."""
    normals = np.asarray(normals, dtype=float)
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    return Contacts(np.asarray(points, dtype=float), np.array([contact_frame(n) for n in normals]))


LOPSIDED = contacts_at(
    [[0.06, 0.01, 0.02], [-0.04, 0.03, -0.01], [0.01, -0.07, 0.03], [0.0, 0.02, -0.05]],
    [[-1.0, 0.1, 0.3], [0.8, -0.5, 0.2], [0.1, 1.0, -0.4], [0.2, 0.1, 1.0]],
)


def moved(contacts: Contacts, rotation: Array, shift: Array) -> Contacts:
    """Return contacts carried along by a rigid motion, frames included."""
    return Contacts(contacts.positions @ rotation.T + shift, rotation @ contacts.rotations)


def three_faces() -> Contacts:
    """Fingers 1 and 2 on the +x and -x faces of the cube, finger 3 on +y."""
    points = HALF * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return contacts_at(points, -points)


def pinch() -> Contacts:
    """Fingers 1 and 2 side by side on the +y face, finger 3 on -y."""
    points = np.array([[0.08, HALF, 0.0], [-0.08, HALF, 0.0], [0.0, -HALF, 0.0]])
    return contacts_at(points, [[0, -1, 0], [0, -1, 0], [0, 1, 0]])


def balance_in_frames(contacts: Contacts) -> Array:
    """Return G~ for forces in contact frames, equation (11), shape (6, 3k)."""
    in_palm = grasp_map(contacts.positions, contacts.positions.mean(axis=0))
    blocks = np.hsplit(in_palm, len(contacts.positions))
    return np.hstack([g @ r for g, r in zip(blocks, contacts.rotations, strict=True)])


vectors = hnp.arrays(float, 3, elements=st.floats(-1.0, 1.0))

rotations = (
    hnp.arrays(float, 4, elements=st.floats(-1.0, 1.0))
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: Rotation.from_quat(q).as_matrix())
)

normals = vectors.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


@st.composite
def point_sets(draw: st.DrawFn, minimum: int = 3, maximum: int = 5, margin: float = 0.1) -> Array:
    """Draw contact points in a palm of some decimeters, far from collinear."""
    k = draw(st.integers(minimum, maximum))
    points = hnp.arrays(float, (k, 3), elements=st.floats(-0.2, 0.2))
    return draw(points.filter(lambda p: collinearity_margin(p) > margin and np.ptp(p) > 0.05))


@st.composite
def grasps(draw: st.DrawFn, minimum: int = 3, maximum: int = 5) -> Contacts:
    """Draw contacts whose normals point roughly, some quite wrongly, to their centroid."""
    points = draw(point_sets(minimum, maximum))
    arms = points.mean(axis=0) - points
    lengths = np.maximum(np.linalg.norm(arms, axis=1), 1e-3)[:, None]
    tilts = draw(hnp.arrays(float, points.shape, elements=st.floats(-1.0, 1.0)))
    tilted = arms / lengths + draw(st.floats(0.0, 1.5)) * tilts
    usable = np.linalg.norm(tilted, axis=1)[:, None] > 0.1
    return contacts_at(points, np.where(usable, tilted, [0.0, 0.0, 1.0]))
