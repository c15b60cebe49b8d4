# SPDX-License-Identifier: Apache-2.0
"""Compile what `compiled` marks, so that no run has to wait: ``python -m ...core.warm_up``."""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.compiled import is_complete, note_complete
from tactile_hand_ros.core.margins import SlipWatch
from tactile_hand_ros.core.rehearsal import example_touch
from tactile_hand_ros.core.scenario import load_scenario
from tactile_hand_ros.core.virtual_frame import VirtualFrame


def warm_up() -> None:
    """Compile everything, unless that was done for these sources and kept."""
    if not is_complete():
        run_every_block()
        note_complete()


def run_every_block() -> None:
    """Run all blocks, with contacts that stick and with some that slip."""
    for name in ("paper", "pull"):  # the plain law, and all that holds against disturbances
        loop = ClosedLoop(load_scenario(name))
        loop.run(3)
    contacts, forces = example_touch(4)
    knows = np.ones(4), np.ones(4, dtype=np.int64), np.zeros(4)  # friction, grip, evidence
    SlipWatch().note(0, contacts, forces, *knows)
    VirtualFrame().orientation(contacts.positions)  # of more than three contacts
    loop.plant.friction[:] = 0.0
    loop.plant.advance(np.full(loop.plant.hand.joints, 0.1))


if __name__ == "__main__":
    warm_up()
