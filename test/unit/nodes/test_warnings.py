# SPDX-License-Identifier: Apache-2.0
"""Nodes warn of what is so: of slips where they threaten, of limits that are too low."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.nodes.force_optimizer import OptimizerReport
from tactile_hand_ros.nodes.slip_regulator import GripState, RegulatorReport
from tactile_hand_ros.ros.diagnostics import Diagnostics
from tactile_hand_ros.scenario.scenario import load_scenario

SECOND = 1000  # ticks


def warnings_of(name: str, seconds: int) -> list[str]:
    """Run a scenario and return what optimizer and regulator warn of, second by second."""
    loop = ClosedLoop(load_scenario(name))
    fingers = loop.plant.hand.finger_names
    optimizer, regulator = Diagnostics("optimizer"), Diagnostics("regulator")
    optimizer_report = OptimizerReport(optimizer)
    regulator_report = RegulatorReport(regulator, fingers)
    regulate, solve = loop.regulator.step, loop.optimizer.step

    def regulated(stamp, contacts, forces):
        grasp_force = regulate(stamp, contacts, forces)
        r = loop.regulator
        state = GripState(r.learned_friction, r.slip_likelihood, r.state)
        regulator_report.note(r, stamp, contacts, forces, state)
        return grasp_force

    def solved(stamp, contacts, friction, forces):
        optimal = solve(stamp, contacts, friction, forces)
        optimizer_report.note(optimal)
        return optimal

    loop.regulator.step, loop.optimizer.step = regulated, solved  # type: ignore[method-assign]
    texts = []
    for _ in range(seconds):
        loop.run(SECOND)
        optimizer_report.report()
        regulator_report.report(loop.regulator)
        for status in (optimizer.status(), regulator.status()):
            texts += [status.message] if status.level != DiagnosticStatus.OK else []
    return texts


@pytest.mark.parametrize("name", ["crush_limit", "lost_contact"])
def test_a_reserve_that_is_used_up_is_no_slip(name: str) -> None:
    assert warnings_of(name, 3) == []
