# SPDX-License-Identifier: Apache-2.0
"""Write a law: (14) with a limit on the force that drives the object to its target."""

import numpy as np

from tactile_hand_ros import OptimalLaw, simulate

LIMIT = 0.1  # N


class GentleLaw(OptimalLaw):
    """Law (14) that pulls the object toward its target with at most LIMIT."""

    def drive(self, wrench: np.ndarray) -> np.ndarray:
        """Return joint torques, shape (m,), N m, for a wrench (force, torque), shape (6,)."""
        force = np.linalg.norm(wrench[:3])
        return super().drive(wrench * min(1.0, LIMIT / max(force, 1e-9)))


for law in ("optimal", GentleLaw):
    result = simulate("paper", law=law)
    speed = np.linalg.norm(np.diff(result.record.auxiliary_position, axis=0), axis=1)
    rate = 1.0 / np.diff(result.record.times)
    name = law if isinstance(law, str) else law.__name__
    error = 1e3 * result.metrics.final_position_error_m
    print(f"{name}: at most {1e3 * (speed * rate).max():.0f} mm/s, {error:.2f} mm off at the end")
