# SPDX-License-Identifier: Apache-2.0
"""What a plant counted in real time becomes a share of missed deadlines with its causes."""

from __future__ import annotations

import math

import pytest

from tactile_hand_ros.run.recording import Deadlines, read_deadlines

FACTS = {
    "late_commands": "3",
    "missed_ticks": "2",
    "lost_s": "0.01",
    "time_s": "1.98",
    "late: preemption": "4",
    "late: unknown": "1",
    "too_slow": "too slow",
}


def test_what_was_late_skipped_or_given_up_is_missed() -> None:
    found = read_deadlines(FACTS, 500.0, 2.0, 2.0)
    assert (found.late, found.skipped, found.causes) == (3.0, 2.0, {"preemption": 4, "unknown": 1})
    assert found.given_up == pytest.approx(5.0)
    assert found.missed_share == pytest.approx(10.0 / 995.0)  # until the plant's last report
    assert found.to_dict()["missed_share"] == found.missed_share
    assert found.too_slow == "too slow"


def test_ticks_that_a_failed_run_never_reached_are_missed() -> None:
    found = read_deadlines(FACTS, 500.0, 4.0, 2.0)
    assert found.given_up == pytest.approx(5.0 + 1000.0)
    assert found.missed_share == pytest.approx(1010.0 / 1995.0)


def test_a_plant_that_has_not_reported_makes_nothing_known() -> None:
    found = read_deadlines({}, 500.0, 2.0, 2.0)
    assert math.isnan(found.late) and math.isnan(found.missed_share)
    assert (dict(found.causes), found.too_slow) == ({}, "")


def test_no_more_than_all_ticks_are_missed_and_causes_without_ticks_are_left_out() -> None:
    facts = FACTS | {"late_commands": "5000", "late: garbage": "0"}
    found = read_deadlines(facts, 500.0, 2.0, 1.0)
    assert found.missed_share == 1.0
    assert found.causes == {"preemption": 4, "unknown": 1}
    assert found.due == pytest.approx(990.0 + 5.0 + 10.0)


def test_what_was_counted_survives_json() -> None:
    found = read_deadlines({}, 500.0, 2.0, 2.0)
    plain = {k: None if v != v else v for k, v in found.to_dict().items()}
    del plain["missed_share"]
    again = Deadlines.from_dict(plain)
    assert again.rate_hz == 500.0 and math.isnan(again.late) and math.isnan(again.due)
    assert Deadlines.from_dict(read_deadlines(FACTS, 500.0, 2.0, 2.0).to_dict()).late == 3.0
