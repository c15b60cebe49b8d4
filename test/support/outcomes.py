# SPDX-License-Identifier: Apache-2.0
"""Run scenarios by function calls, in processes that can import this."""

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.closed_loop.scenario import load_scenario


def run_scenario(name: str, changes: dict) -> Record:
    """Return the record of a scenario with some values changed."""
    return ClosedLoop(load_scenario(name, changes)).run()
