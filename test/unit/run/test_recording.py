# SPDX-License-Identifier: Apache-2.0
"""What a plant counted in real time becomes a fraction of missed deadlines."""

from __future__ import annotations

import math

import pytest

from tactile_hand_ros.run.recording import real_time_counts

FACTS = {"late_commands": "3", "missed_ticks": "2", "lost_s": "0.01", "time_s": "1.98"}


def test_what_was_late_skipped_or_given_up_is_missed() -> None:
    found = real_time_counts(FACTS, 500.0, 2.0, 2.0)
    assert (found.late, found.skipped) == (3.0, 2.0)
    assert found.given_up == pytest.approx(5.0)
    assert found.missed_fraction == pytest.approx(10.0 / 995.0)  # until the plant's last report
    assert found.to_dict()["missed_fraction"] == found.missed_fraction


def test_ticks_that_a_failed_run_never_reached_are_missed() -> None:
    found = real_time_counts(FACTS, 500.0, 4.0, 2.0)
    assert found.given_up == pytest.approx(5.0 + 1000.0)
    assert found.missed_fraction == pytest.approx(1010.0 / 1995.0)


def test_a_plant_that_has_not_reported_makes_nothing_known() -> None:
    found = real_time_counts({}, 500.0, 2.0, 2.0)
    assert math.isnan(found.late) and math.isnan(found.missed_fraction)


def test_no_more_than_all_ticks_are_missed() -> None:
    found = real_time_counts(FACTS | {"late_commands": "5000"}, 500.0, 2.0, 1.0)
    assert found.missed_fraction == 1.0
    assert found.due == pytest.approx(990.0 + 5.0 + 10.0)
