# SPDX-License-Identifier: Apache-2.0
"""Compile what `compiled` marks, so that no run has to wait: ``python -m ...core.warm_up``."""

from __future__ import annotations

import numpy as np

from tactile_hand_ros.core.closed_loop import ClosedLoop
from tactile_hand_ros.core.compiled import completeness
from tactile_hand_ros.core.grasp import net_wrench
from tactile_hand_ros.core.scenario import load_scenario


def warm_up() -> None:
    """Run all blocks with contacts that stick and with some that slip, once for these sources."""
    done = completeness()
    if done is not None and done.exists():
        return
    loop = ClosedLoop(load_scenario("paper"))
    loop.run(2)
    state = loop.plant.state
    net_wrench(state.contacts, state.forces)
    loop.plant.friction[:] = 0.0
    loop.plant.advance(np.full(loop.plant.hand.joints, 0.1))
    if done is not None and done.parent.is_dir():
        done.touch()


if __name__ == "__main__":
    warm_up()
