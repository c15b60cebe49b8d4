# SPDX-License-Identifier: Apache-2.0
"""Palm and links against the object, by the collision shapes of the URDF; fingertips may touch."""

from __future__ import annotations

import coal
import pinocchio as pin

from tactile_hand_ros.compiled import Array
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.simulation.solid import Solid


class LinkCollisions:
    """Finds palm and links that an object intersects; those without collision shapes never do.

    Attributes:
        names: Palm and links with collision shapes, but for the tips.
    """

    def __init__(self, hand: Hand, solid: Solid) -> None:
        """Read the shapes of the hand's URDF; a hand whose meshes are missing has none."""
        self._hand, self._data = hand, hand.model.createData()
        folders, kind = [str(folder) for folder in hand.file.parents], pin.GeometryType.COLLISION
        try:
            geometry = pin.buildGeomFromUrdfString(
                hand.model, hand.description, kind, package_dirs=folders
            )
        except ValueError:
            geometry = pin.GeometryModel()
        bodies = enumerate(geometry.geometryObjects)
        named = {i: hand.model.frames[body.parentFrame].name for i, body in bodies}
        self._links = {i: name for i, name in named.items() if name not in hand.tip_links}
        self.names = set(self._links.values())
        self._geometry, self._placed = geometry, geometry.createData()
        self._object = coal.BVHModelOBBRSS()
        self._object.beginModel(len(solid.vertices), len(solid.vertices))
        for corners in solid.triangles():
            self._object.addTriangle(*corners)
        self._object.endModel()

    def touching(self, theta: Array, position: Array, rotation: Array) -> list[str]:
        """Return the names of links that intersect the object, each once.

        Args:
            theta: Joint angles, shape (m,), rad.
            position: Origin of the object, palm frame, shape (3,), m.
            rotation: Its frame in the palm frame, shape (3, 3).
        """
        moved = self._hand.model, self._data, self._geometry, self._placed
        pin.updateGeometryPlacements(*moved, self._hand.all_angles(theta))
        at, found = coal.Transform3s(rotation, position), dict[str, None]()
        for i, name in self._links.items():
            place = self._placed.oMg[i]
            there = coal.Transform3s(place.rotation, place.translation)
            shape = self._geometry.geometryObjects[i].geometry
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            if coal.collide(shape, there, self._object, at, request, result):
                found[name] = None
        return list(found)
