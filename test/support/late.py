# SPDX-License-Identifier: Apache-2.0
"""A regulator whose answers are late, in the closed loop by function calls."""

from collections import deque

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.scenario import load_scenario
from tactile_hand_ros.control.slip.regulator import SlipRegulator

LATE, EVERY = 3, 3  # ticks that an answer takes; of so many ticks one is answered
# Until the worst of the load has come.
SECONDS = {"pull": 2.6, "gravity": 2.0, "slippery": 3.6, "heavy": 3.0}


class LateRegulator(SlipRegulator):
    """Feels every tick, answers some of them, and its answers arrive late."""

    def __init__(self, config, fingers):
        super().__init__(config, fingers)
        self._count, self._sent = 0, deque([config.grasp_force], maxlen=LATE + 1)

    def step(self, stamp, contacts=None, forces=None):
        answer = super().step(stamp, contacts, forces)
        self._sent.append(answer if self._count % EVERY == 0 else self._sent[-1])
        self._count += 1
        return self._sent[0]


def run_late(name):
    scenario = load_scenario(name)
    loop = ClosedLoop(scenario)
    loop.regulator = LateRegulator(scenario.slip_regulator, loop.plant.hand.fingers)
    record = loop.run(round(SECONDS[name] * scenario.plant.rate))
    return record.true_positions[-1], record.true_slid[-1], record.grasp_force.max()
