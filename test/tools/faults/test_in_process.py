# SPDX-License-Identifier: Apache-2.0
"""A short campaign in-process: nothing is dropped where an ideal hold drops nothing."""

import pytest
from support.outcomes import InParallel

from studies.faults.in_process import run_in_process
from studies.faults.space import Injection


def injection(situation, component, fault, seed=1):
    return Injection("in-process", situation, component, fault, seed)


AGAIN = injection("pulled", "regulator", "intermittent")
STARVED = injection("pulled", "computer", "starved")
NO_FAULT = injection("lifting", "user commands", "none")
FAILING = [
    injection("moving", "controller", "off"),
    injection("lifting", "skin of all fingers", "garbage"),
    injection("pulled", "optimizer", "delayed"),
    injection("heavy", "joint link", "clock step"),
    injection("human, at rest", "regulator", "off"),
]
WRONG = [
    injection("heavy", "skin of one finger", "wrong", 1033789),
    injection("lifting", "skin of all fingers", "stuck", 1512273227),
]


@pytest.fixture(scope="module")
def outcomes():
    runs = [AGAIN, *FAILING, STARVED, NO_FAULT, *WRONG]
    return InParallel(run_in_process, {run: (run,) for run in runs})


def test_a_run_is_the_same_again_in_another_process(outcomes):
    assert outcomes[AGAIN] == run_in_process(AGAIN)


@pytest.mark.parametrize("run", FAILING)
def test_a_part_that_fails_costs_no_object(outcomes, run):
    seen = outcomes[run]
    assert not seen.dropped and seen.moved < 0.004
    assert seen.safe is not None and seen.safe < 0.02
    assert seen.peak < 1.2 * seen.limit and seen.recovered is not None


def test_a_starved_computer_costs_no_object_and_little_way(outcomes):
    """Late answers in bursts: the hand stands still instead of being passed to and fro."""
    seen = outcomes[STARVED]
    assert not seen.dropped and seen.moved < 0.006 and seen.peak < 60.0


def test_without_a_fault_nothing_is_declared(outcomes):
    seen = outcomes[NO_FAULT]
    assert not seen.dropped and seen.safe is None and seen.recovered == 0.0


@pytest.mark.parametrize("run", WRONG)
def test_touch_that_is_wrong_is_not_remembered(outcomes, run):
    """Regulator and optimizer take a load that was none for one; this moved the object 73 mm."""
    seen = outcomes[run]
    assert not seen.dropped and seen.moved < 0.003 and seen.peak < 1.2 * seen.limit
