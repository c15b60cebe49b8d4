# SPDX-License-Identifier: Apache-2.0
"""The orchestrator: start the nodes of a scenario, watch, command, stop and summarize."""

from tactile_hand_ros.orchestrator.command import main

__all__ = ["main"]
