# SPDX-License-Identifier: Apache-2.0
"""Run scenarios by function calls, in processes that can import this."""

from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.record import Record
from tactile_hand_ros.core.scenario import load_scenario


def run_scenario(name: str, changes: dict) -> Record:
    """Return the record of a scenario with some values changed."""
    return ClosedLoop(load_scenario(name, changes)).run()
