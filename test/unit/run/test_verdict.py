# SPDX-License-Identifier: Apache-2.0
"""A run is judged by its goal; quantities unknown to touch do not count against it."""

import math
from dataclasses import replace

import pytest

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.run.events import Asked, releases
from tactile_hand_ros.run.metrics import Judged, metrics
from tactile_hand_ros.scenario.scenario import GoalConfig

GOAL = GoalConfig(position_error=0.01, rotation_error=0.1, slip_distance=0.002)
UNKNOWN = metrics(Record.empty(1, ["a"], ["j"]))


def test_each_number_is_judged_by_its_own_limit():
    known = replace(UNKNOWN, final_position_error_m=0.02, final_rotation_error_rad=0.05)
    assert known.judged(GOAL) == [
        Judged("final position error", 0.02, 0.01, "m"),
        Judged("final rotation error", 0.05, 0.1, "rad"),
    ]
    slid = replace(known, max_slip_distance_m=0.0).judged(GOAL)[2]
    assert slid == Judged("longest slip", 0.0, 0.002, "m")


@pytest.mark.parametrize(("value", "passed"), [(0.1, True), (0.1001, False), (math.nan, False)])
def test_a_number_passes_up_to_its_limit(value, passed):
    assert Judged("x", value, 0.1, "m").passed is passed


@pytest.mark.parametrize(
    ("dropped", "steered", "reached", "words"),
    [
        (1.25, True, True, "object dropped at 1.250 s"),
        (0.0, False, False, "object dropped at 0.000 s"),
        (math.nan, True, False, "finished"),
        (math.nan, False, True, "goal reached"),
        (math.nan, False, False, "goal not reached"),
        (math.nan, False, None, ""),
    ],
)
def test_what_became_of_a_run(dropped, steered, reached, words):
    found = replace(UNKNOWN, dropped_at_s=dropped, goal_reached=reached)
    assert found.headline(steered=steered) == words


def test_the_hand_is_open_from_the_last_time_it_was_asked_to_until_it_grasps():
    opens, closes = Asked(2 * 10**9, "grasp", "false"), Asked(3 * 10**9, "grasp", "true")
    other = Asked(4 * 10**9, "enable", "false")
    assert releases([]) == releases([other]) == releases([opens, closes]) == []
    assert releases([opens, other]) == [2.0]
    assert releases([closes, opens, closes, opens._replace(stamp=5 * 10**9)]) == [5.0]
