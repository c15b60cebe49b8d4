# SPDX-License-Identifier: Apache-2.0
"""The orchestrator: starts the nodes of a scenario, watches, commands, stops and summarizes."""

from tactile_hand_ros.orchestrator.command import main

__all__ = ["main"]
