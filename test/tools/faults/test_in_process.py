# SPDX-License-Identifier: Apache-2.0
"""A short campaign in-process: nothing is dropped where an ideal hold drops nothing."""

import pytest
from joblib import Parallel, delayed

from studies.faults.in_process import run_in_process
from studies.faults.space import Injection


def injection(situation, component, fault, seed=1):
    return Injection("in-process", situation, component, fault, seed)


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


def test_a_run_is_the_same_again_in_another_process():
    run = injection("pulled", "regulator", "intermittent")
    [elsewhere] = Parallel(n_jobs=2)([delayed(run_in_process)(run)])
    assert elsewhere == run_in_process(run)


@pytest.mark.parametrize("run", FAILING)
def test_a_part_that_fails_costs_no_object(run):
    seen = run_in_process(run)
    assert not seen.dropped and seen.moved < 0.004
    assert seen.safe is not None and seen.safe < 0.02
    assert seen.peak < 1.2 * seen.limit and seen.recovered is not None


def test_a_starved_computer_costs_no_object_and_little_way():
    """Late answers in bursts: the hand stands still instead of being passed to and fro."""
    seen = run_in_process(injection("pulled", "computer", "starved"))
    assert not seen.dropped and seen.moved < 0.006 and seen.peak < 60.0


@pytest.mark.parametrize("seed", [2, 3])
def test_where_a_computer_stays_starved_a_soft_hold_does_not_let_the_object_creep(
    monkeypatch, seed
):
    """Commands return for moments; a hold that then lost its load moved the object 15 mm."""
    monkeypatch.setattr("studies.faults.in_process.FAULT_TIME", 4.0)
    run = Injection("processes", "human, pulled", "computer", "starved", seed)
    seen = run_in_process(run)
    assert not seen.dropped and seen.moved < 0.003


def test_without_a_fault_nothing_is_declared():
    seen = run_in_process(injection("lifting", "user commands", "none"))
    assert not seen.dropped and seen.safe is None and seen.recovered == 0.0


@pytest.mark.parametrize("run", WRONG)
def test_touch_that_is_wrong_is_not_remembered(run):
    """Regulator and optimizer take a load that was none for one; this moved the object 73 mm."""
    seen = run_in_process(run)
    assert not seen.dropped and seen.moved < 0.003 and seen.peak < 1.2 * seen.limit
