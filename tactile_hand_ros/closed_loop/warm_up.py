# SPDX-License-Identifier: Apache-2.0
"""Compile all marked functions ahead of a run: `python -m tactile_hand_ros.closed_loop.warm_up`."""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.compiled import is_complete, mark_complete
from tactile_hand_ros.control.contact import example_touch
from tactile_hand_ros.control.grasp import VirtualFrame
from tactile_hand_ros.control.margins import GraspMonitor, SlipMonitor
from tactile_hand_ros.scenario.scenario import load_scenario


def warm_up() -> None:
    """Compile everything, unless these sources are already compiled."""
    if not is_complete():
        run_every_block()
        mark_complete()


def run_every_block() -> None:
    """Run all blocks, with contacts that stick and with some that slip."""
    for name in ("paper", "pull"):  # the plain law, and all defenses against disturbances
        loop = ClosedLoop(load_scenario(name))
        loop.run(3)
    contacts, forces = example_touch(4)
    estimates = np.ones(4), np.ones(4, dtype=np.int64), np.zeros(4)  # friction, grip, evidence
    SlipMonitor().note(0, contacts, forces, *estimates)
    state = loop.plant.state
    GraspMonitor(loop.plant.hand).margins(state.theta, state.contacts)
    VirtualFrame().orientation(contacts.positions)  # of more than three contacts
    loop.plant.friction[:] = 0.0
    loop.plant.advance(np.full(loop.plant.hand.joints, 0.1))


if __name__ == "__main__":
    warm_up()
