# SPDX-License-Identifier: Apache-2.0
"""A recorded run through the real nodes once more, over real DDS."""

from __future__ import annotations

from pathlib import Path

from support.recorded import RunWriter, write_run

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved
from tactile_hand_ros.verify.replay_through_nodes import replay_through_nodes


def test_real_nodes_give_what_was_recorded_byte_for_byte(tmp_path: Path) -> None:
    """And with another gain other torques, from the same squeeze."""
    scenario = load_scenario("paper", {"duration": 0.5})
    record = ClosedLoop(scenario).run(60)
    with RunWriter(tmp_path / "bag", {"scenario": resolved(scenario)}) as bag:
        write_run(bag, scenario, record)
    comparisons = replay_through_nodes(Run(tmp_path))
    assert [c for c in comparisons if not c.same] == []
    assert [c.compared for c in comparisons] == 7 * [60]
    differing = {
        c.topic for c in replay_through_nodes(Run(tmp_path), {"law.k_p": 4.0}) if not c.same
    }
    assert differing == {"joint_command"}
