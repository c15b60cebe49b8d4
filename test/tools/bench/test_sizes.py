# SPDX-License-Identifier: Apache-2.0
"""Hands of every size hold their object, and what they cost is summed up and drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.figures import sizes_figure
from bench.hands import HandSizeError, posture_for, write_hand
from bench.sizes import (
    BLOCKS,
    Size,
    loop_times,
    measure_sizes,
    results,
    sized_scenario,
    sizes,
)
from bench.workload import Workload
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.style import save


def test_the_sizes_that_are_asked_for_are_measured() -> None:
    found = {(size.fingers, size.joints) for size in sizes()}
    assert found == {(fingers, joints) for fingers in (3, 4, 5) for joints in (3, 4, 5, 6)}
    steps = [size.step for size in sizes()]
    assert (max(steps), min(steps)) == (1e-3, 1e-4)


@pytest.mark.parametrize("size", [Size(3, 6), Size(5, 3), Size(4, 5, 1e-4)], ids=str)
def test_a_hand_of_any_size_moves_its_object(tmp_path: Path, size: Size) -> None:
    scenario = sized_scenario(tmp_path, size)
    loop = ClosedLoop(scenario)
    assert loop.plant.hand.fingers == size.fingers
    assert len(loop.plant.hand.joint_names) == size.fingers * size.joints
    record = loop.run(1000)
    assert np.isfinite(record.true_positions).all()
    target = np.array(scenario.targets[0].position)
    error = np.linalg.norm(record.auxiliary_position - target, axis=1)
    assert error[-1] < 0.9 * error[0]


def test_measured_sizes_become_rows_and_a_figure(tmp_path: Path) -> None:
    chosen = [Size(3, 3), Size(4, 3), Size(3, 3, 5e-4)]
    heard: list[str] = []
    costs = measure_sizes(chosen, ticks=5, rounds=2, progress=heard.append)
    assert heard == [str(size) for size in chosen] * 2
    rows = results(costs)
    assert len(rows) == len(chosen) * len(BLOCKS)
    assert all(row.count == 10 and row.median > 0.0 for row in rows)
    assert {row.name for row in rows} >= {f"controller: {size}" for size in chosen}
    (file,) = save(sizes_figure(costs), tmp_path, "sizes", ("png",))
    assert file.stat().st_size > 1000


def test_two_hands_tick_in_turns() -> None:
    work = Workload.prepare(ticks=3, repeats=1)
    assert loop_times(work, 2).shape == (3,)


def test_fingers_that_do_not_reach_are_refused(tmp_path: Path) -> None:
    hand = Hand.load(str(write_hand(tmp_path, [3, 3, 3])))
    with pytest.raises(HandSizeError, match="short of their places"):
        posture_for(hand, np.full((3, 3), 5.0))
