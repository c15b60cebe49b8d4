# SPDX-License-Identifier: Apache-2.0
"""The command `tactile-hand`."""

from tactile_hand_ros.cli.app import main

__all__ = ["main"]
