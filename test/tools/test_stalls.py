# SPDX-License-Identifier: Apache-2.0
"""What commands that stop do to an object, with the guard and without it."""

import pytest
from support.outcomes import watched

from tactile_hand_ros.scenario.scenario import load_scenario


def load(kind: str, force: float, **timing: float):
    """Return a scenario under a load that changes while there are no commands."""
    carried = {"kind": "step", "start": 0.0, "force": [0.0, 0.0, 1.962]}
    comes = {"kind": kind, "start": 0.3, "force": [0.0, 0.0, force], **timing}
    return load_scenario("lift", {"plant.disturbances": [carried, comes]})


SCENARIOS = {
    "the weight comes on": load("ramp", -1.962, duration=0.2),
    "five times the weight comes on": load("ramp", -9.81, duration=0.4),
    "a sudden pull": load("step", -10.0),
    "moving": load_scenario("paper"),
}


def stalled(name: str, seconds: float, *, guarded: bool = True):
    """Return the outcome of a stall that begins at 0.3 s and its loop."""
    loop, watch = watched(SCENARIOS[name], 0.3, guarded=guarded)
    watch.run(seconds, answers=False)
    return watch, loop


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_stall_costs_no_object(name):
    watch, guarded = stalled(name, 0.6)
    assert guarded.guard.reason
    watch.run(0.3, answers=True, moves=True)
    assert not watch.is_lost and not guarded.guard.holding
    assert watch.moved < 0.006 and watch.slid < 0.003
    assert watch.peak < 1.2 * guarded.loop.scenario.slip_regulator.maximum


@pytest.mark.parametrize(("name", "lasts"), [("a sudden pull", 0.3), ("the weight comes on", 0.6)])
def test_the_same_stall_without_the_guard_drops_it(name, lasts):
    watch, _ = stalled(name, lasts, guarded=False)
    assert watch.is_lost


def test_a_stall_shorter_than_the_age_limit_changes_nothing():
    _, guarded = stalled("moving", 0.006)
    _, unguarded = stalled("moving", 0.006, guarded=False)
    assert not guarded.guard.reason
    assert (guarded.loop.state.theta == unguarded.loop.state.theta).all()


def test_commands_that_are_always_late_let_the_hand_stand_still():
    guarded, watch = watched(SCENARIOS["moving"], 0.3)
    watch.run(0.5, answers=True, delay=4)
    assert guarded.guard.reason and not watch.is_lost and watch.moved < 0.003
