# SPDX-License-Identifier: Apache-2.0
"""What real time does to the regulator, without a clock: answers that are late, ticks skipped."""

from collections import deque

import numpy as np
import pytest

from studies.stalls import GuardedLoop
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.scenario.scenario import load_scenario

LATE, EVERY = 3, 3  # delay of an answer in ticks; one of so many ticks is answered
# Until the highest load.
SECONDS = {"pull": 2.3, "gravity": 1.8, "slippery": 3.3, "heavy": 2.6}


class LateRegulator(SlipRegulator):
    """Processes every tick, answers some of them, and answers late."""

    def __init__(self, config):
        super().__init__(config)
        self._count, self._sent = 0, deque([config.grasp_force], maxlen=LATE + 1)

    def step(self, *inputs):
        answer = super().step(*inputs)
        self._sent.append(answer if self._count % EVERY == 0 else self._sent[-1])
        self._count += 1
        return self._sent[0]


@pytest.mark.parametrize("name", SECONDS)
def test_a_regulator_that_is_three_ticks_late_keeps_the_object(name):
    scenario = load_scenario(name)
    loop = ClosedLoop(scenario)
    loop.chain.regulator = LateRegulator(scenario.slip_regulator)
    record = loop.run(round(SECONDS[name] * scenario.plant.rate))
    assert np.isfinite(record.true_positions[-1]).all()
    assert record.true_slid[-1].max() < 5e-3
    assert record.grasp_force.max() <= scenario.slip_regulator.maximum


JITTER = (1, 3)  # ticks, minimum and maximum delay of a command
# Until the grasp force has come to rest after the load.
SHORTER = {"pull": 3.0, "gravity": 3.5}


def run_with_late_commands(name, seed):
    """Run a scenario at 500 Hz with randomly delayed commands; if `seed` is None, none is late.

    Return whether the object is held at the end, mean k_f of the last 0.5 s, and the largest slip.
    """
    scenario = load_scenario(name, {"plant.rate": 500.0, "duration": SHORTER[name]})
    guarded = GuardedLoop(scenario)
    random, forces = np.random.default_rng(seed), []
    for tick in range(scenario.ticks):
        is_late = seed is not None and tick >= JITTER[1]  # time starts with the first command
        guarded.tick(delay=int(random.integers(*JITTER, endpoint=True)) if is_late else 0)
        forces.append(guarded.loop.regulator.grasp_force)
    state = guarded.loop.state
    return bool(state.contacts.all_touching), np.mean(forces[-250:]), state.slid.max()


@pytest.mark.parametrize("name", SHORTER)
def test_commands_that_are_late_now_and_then_are_no_slip(name):
    """By 1 to 3 ticks: the jerks of the torques once raised the grasp force to its limit."""
    _, in_time, _ = run_with_late_commands(name, None)
    is_held, grasp_force, slid = run_with_late_commands(name, 1)
    assert is_held and slid < 1e-3
    assert grasp_force <= 1.2 * in_time
