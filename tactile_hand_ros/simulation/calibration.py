# SPDX-License-Identifier: Apache-2.0
"""What the hand knows wrongly of itself: the true hand differs from the model of its controllers.

The plant has the true hand. Everything else, the skin's driver among them, works with the model:
a contact is reported where the model says that fingertip is.
"""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.config.model import Config, param

Vector = tuple[float, float, float]


class CalibrationConfig(Config):
    """Errors of calibration, the same for all fingers; by default there are none."""

    link_lengths: float = param(
        1.0, "true lengths of all links against those of the URDF", ge=0.5, le=2.0
    )
    tip_radii: float = param(
        1.0, "true radii of the fingertips against those of the hand's YAML", ge=0.5, le=2.0
    )
    skin_rotation: Vector = param(
        (0.0, 0.0, 0.0),
        "rotation vector by which skins report contacts turned, axes of the fingertip",
        unit="rad",
    )
    gravity_rotation: Vector = param(
        (0.0, 0.0, 0.0),
        "rotation vector of true gravity against the one that the hand knows, palm axes",
        unit="rad",
    )

    @property
    def is_right(self) -> bool:
        """Whether the hand knows everything as it is."""
        lengths = self.link_lengths == self.tip_radii == 1.0
        return lengths and not np.any([self.skin_rotation, self.gravity_rotation])
