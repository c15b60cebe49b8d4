# SPDX-License-Identifier: Apache-2.0
"""Run scenarios with events, failing skins or a guard, and judge whether they could be held."""

from collections.abc import Callable
from typing import Any

import numpy as np

from studies.slip.minimum import minimum_at
from studies.stalls import GuardedLoop, Watch
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.scenario.scenario import Scenario

_STEP = 0.05  # s between checked instants, besides the starts of loads


def with_failing_skin(loop: ClosedLoop, finger: int, fault: str, first: int) -> Record:
    """Run a loop to its end and return the record; the skin of a finger fails at a tick."""
    skin, faults = loop.chain.sensor, ["none"] * loop.plant.hand.fingers
    faults[finger] = fault
    failing = skin.config.model_copy(update={"faults": faults})
    return run_with(loop, {first: lambda: skin.configure(failing)})


def run_with(loop: ClosedLoop, events: dict[int, Callable[[], Any]]) -> Record:
    """Run a loop to its end and return the record; each event happens before its tick."""
    hand, ticks = loop.plant.hand, loop.scenario.ticks
    record = Record.empty(ticks, hand.finger_names, hand.joint_names)
    for row in range(ticks):
        if row in events:
            events[row]()
        loop.tick(record, row)
    return record


def watched(scenario: Scenario, after: float, **how: Any) -> tuple[GuardedLoop, Watch]:
    """Run a guarded loop for some time, s, and return it with a watch from then on."""
    guarded = GuardedLoop(scenario, **how)
    guarded.run(after)
    return guarded, Watch(guarded)


def can_be_held(record: Record, scenario: Scenario) -> bool:
    """Return whether a grasp inside the crush limit can carry every load of a run.

    With true load and friction at the contacts of the grasp. After a lost contact, the last
    complete grasp counts, because the question is whether it had to be lost. Only the true contacts
    and the object's pose of `record` are used.
    """
    whole = np.isfinite(record.true_positions[:, :, 0]).all(axis=1)
    grasps = np.maximum.accumulate(np.where(whole, np.arange(len(record)), 0))
    starts = [d.start for d in scenario.plant.disturbances]
    starts += [c.start for c in scenario.plant.friction_changes]
    times = np.union1d(np.arange(0.0, scenario.duration, _STEP), np.array(starts) + 1e-6)
    for time in times[times <= scenario.duration]:
        row = min(int(np.searchsorted(record.times, time)), len(record) - 1)
        # For a sudden event, the grasp before it.
        least = minimum_at(record, scenario, float(time), int(grasps[max(row - 1, 0)]))
        if least > scenario.slip_regulator.maximum:
            return False
    return True
