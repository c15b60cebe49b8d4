# SPDX-License-Identifier: Apache-2.0
"""The assumption ledger on the paper's grasp, and on records in which something breaks."""

import numpy as np
import pytest
from support.outcomes import run_scenario

from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.run.ledger import ledger

HAND = Hand.load("paper")


@pytest.fixture
def record():
    return run_scenario("paper", {"duration": 1.0})


def lines(record):
    return {line.name: line for line in ledger(record, HAND)}


def test_every_assumption_holds_in_the_papers_world(record):
    found = lines(record)
    assert list(found) == ["A1", "A2", "A3", "A4", "A4 cone", "A5", "A6", "A7", "(13)"]
    judged = [line for line in found.values() if not np.isnan(line.held_share)]
    assert len(judged) == 7
    assert all(line.held_share == 1.0 and not line.broken for line in judged)


def test_the_angle_to_the_rim_is_that_of_the_papers_posture(record):
    """The last link points 30 degrees above the horizontal, the contact normal lies in it."""
    start = 0.5 * np.pi - np.radians(30.0)
    assert lines(record)["A2"].worst <= start + 1e-3
    still = run_scenario("paper", {"duration": 0.2, "targets": []})
    assert lines(still)["A2"].worst == pytest.approx(start, abs=2e-3)


def test_a_lost_contact_breaks_a7_for_as_long_as_it_lasts(record):
    record.contact_positions[200:300, 2] = np.nan
    line = lines(record)["A7"]
    assert line.worst == 0.0
    assert line.broken == [(pytest.approx(0.4), pytest.approx(0.598))]
    assert line.held_share == pytest.approx(1 - 100 / 476, abs=0.01)


def test_a_slip_breaks_a4_at_once_and_a6_when_it_lasts(record):
    record.grip[200:230, 1] = 2  # 60 ms
    found = lines(record)
    assert found["A4"].broken == [(pytest.approx(0.4), pytest.approx(0.458))]
    assert found["A6"].worst == pytest.approx(0.02 - 0.06, abs=2e-3)
    record.grip[205:230, 1] = 1  # 10 ms
    assert not lines(record)["A6"].broken


def test_weight_breaks_a3(record):
    heavy = run_scenario("lift", {"duration": 0.3})
    assert not lines(heavy)["A3"].broken
    pulled = run_scenario("hold", {"duration": 0.3})
    assert lines(pulled)["A3"].held_share == 0.0
    assert lines(pulled)["A3"].worst == pytest.approx(1.962, rel=0.2)


def test_unknown_touch_gives_no_verdict(record):
    record.grip[:] = np.nan
    record.slip_evidence[:] = np.nan
    assert np.isnan(lines(record)["A4"].held_share)
    assert lines(record)["A4"].to_dict()["worst"] is None
