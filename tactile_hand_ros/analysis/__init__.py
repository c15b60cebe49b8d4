# SPDX-License-Identifier: Apache-2.0
"""Measuring and drawing of runs: `Run` opens one from disk, `metrics` tells what it achieved."""

from tactile_hand_ros.analysis.metrics import Metrics, metrics
from tactile_hand_ros.analysis.run import Run

__all__ = ["Metrics", "Run", "metrics"]
