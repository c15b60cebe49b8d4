# SPDX-License-Identifier: Apache-2.0
"""A short campaign in-process: nothing is dropped where an ideal hold drops nothing."""

import pytest

from studies.faults.in_process import run_in_process
from studies.faults.space import Injection


def outcome(situation, component, fault, seed=1):
    return run_in_process(Injection("in-process", situation, component, fault, seed))


def test_a_run_is_the_same_again():
    run = "pulled", "regulator", "intermittent"
    assert outcome(*run) == outcome(*run)


@pytest.mark.parametrize(
    ("situation", "component", "fault"),
    [
        ("moving", "controller", "off"),
        ("lifting", "skin of all fingers", "garbage"),
        ("pulled", "optimizer", "delayed"),
        ("heavy", "joint link", "clock step"),
        ("human, at rest", "regulator", "off"),
    ],
)
def test_a_part_that_fails_costs_no_object(situation, component, fault):
    seen = outcome(situation, component, fault)
    assert not seen.dropped and seen.moved < 0.004
    assert seen.safe is not None and seen.safe < 0.02
    assert seen.peak < 1.2 * seen.limit and seen.recovered is not None


def test_a_starved_computer_costs_no_object_and_little_way():
    """Late answers in bursts: the hand stands still instead of being passed to and fro."""
    seen = outcome("pulled", "computer", "starved")
    assert not seen.dropped and seen.moved < 0.006 and seen.peak < 60.0


def test_without_a_fault_nothing_is_declared():
    seen = outcome("lifting", "user commands", "none")
    assert not seen.dropped and seen.safe is None and seen.recovered == 0.0


@pytest.mark.parametrize(
    ("situation", "component", "fault", "seed"),
    [
        ("heavy", "skin of one finger", "wrong", 1033789),
        ("lifting", "skin of all fingers", "stuck", 1512273227),
    ],
)
def test_touch_that_is_wrong_is_not_remembered(situation, component, fault, seed):
    """Regulator and optimizer take a load that was none for one; this moved the object 73 mm."""
    seen = outcome(situation, component, fault, seed)
    assert not seen.dropped and seen.moved < 0.003 and seen.peak < 1.2 * seen.limit
