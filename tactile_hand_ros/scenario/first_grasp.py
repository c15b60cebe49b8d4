# SPDX-License-Identifier: Apache-2.0
"""The grasp with which a scenario begins, as it follows from hand and object."""

from __future__ import annotations

from tactile_hand_ros.control.virtual_frame import VirtualFrame
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.rotations import vector_from_rotation
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import PlantConfig


def first_rotation(config: PlantConfig) -> tuple[float, float, float]:
    """Return the orientation of the virtual frame at the start, a rotation vector in rad.

    Raises:
        HandModelError: If the hand cannot be built.
        ObjectModelError: If the object cannot be built or does not fit into the hand.
        GraspError: If a finger does not touch or the contacts do not define a frame (A7).
    """
    contacts = Plant(config).state.contacts
    if not contacts.all_touching:
        raise GraspError(
            "rotation: keep needs a grasp at the start, but a finger does not touch; change "
            "initial_joints, the layout, or the object's size or place"
        )
    frame = VirtualFrame().orientation(contacts.positions)
    x, y, z = vector_from_rotation(frame).tolist()
    return x, y, z
