# SPDX-License-Identifier: Apache-2.0
"""The failure that everything around bags raises."""

from __future__ import annotations

from tactile_hand_ros.core.errors import TactileHandError


class BagError(TactileHandError):
    """A bag that cannot be written or read, with the reason and what to do."""
