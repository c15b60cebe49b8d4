# SPDX-License-Identifier: Apache-2.0
"""Slip prevention is blind to touch that the controller doubts: true touch is never doubted."""

import pytest

from studies.slip.study import EVENTS, SlipCase, sample_cases, scenario_of
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record

LATE = [case for case in sample_cases(60, 3) if case.latency > 0.008 and case.rate == 250.0]


@pytest.mark.parametrize("event", EVENTS)
def test_a_late_and_slow_skin_is_believed_when_the_object_begins_to_slip(event):
    case: SlipCase = next(case for case in LATE if case.event == event)
    loop = ClosedLoop(scenario_of(case))
    record = Record.empty(
        loop.scenario.ticks, loop.plant.hand.finger_names, loop.plant.hand.joint_names
    )
    for row in range(loop.scenario.ticks):
        loop.tick(record, row)
        assert not loop.controller.touch_rejected
