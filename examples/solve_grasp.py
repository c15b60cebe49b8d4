# SPDX-License-Identifier: Apache-2.0
"""Solve (13): how should three fingers share the grasp force on a cube of 60 mm?"""

import numpy as np

from tactile_hand_ros import Contacts, ForceOptimizer, ForceOptimizerConfig, contact_frame

# Index and middle finger press on one face, the thumb on the opposite one: points in m, palm frame.
positions = np.array([[-0.010, 0.030, 0.0], [0.014, 0.030, 0.0], [0.0, -0.030, 0.0]])
inward = np.array([[0.0, -1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
contacts = Contacts(positions, np.array([contact_frame(normal) for normal in inward]))

config = ForceOptimizerConfig(weights=[10.0, 1.0, 10.0])  # tangential force is expensive
solution = ForceOptimizer(config, fingers=3).solve(contacts)

print(f"{solution.status.value}, optimality residual {solution.residual:.0e}")
for name, (x, normal, z) in zip(("index", "middle", "thumb"), solution.forces, strict=True):
    needed = np.hypot(x, z) / normal
    print(f"{name:6} normal {normal:.3f}, tangential {np.hypot(x, z):.3f}, friction {needed:.3f}")

# The forces cancel each other: pressing harder does not move the object.
in_palm = np.einsum("kij,kj->ki", contacts.rotations, solution.forces)
print(f"net force {np.abs(in_palm.sum(axis=0)).max():.0e} per newton of grasp force")
