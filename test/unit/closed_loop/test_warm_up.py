# SPDX-License-Identifier: Apache-2.0
"""What is run so that all of it is compiled: every block, with grasps that stick and that slip."""

import numpy as np
import pytest

from tactile_hand_ros.closed_loop import warm_up
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.control.margins import GraspMonitor, SlipMonitor
from tactile_hand_ros.control.virtual_frame import VirtualFrame
from tactile_hand_ros.simulation.plant import Plant

WATCHED = {
    ClosedLoop: "run",
    SlipMonitor: "note",
    GraspMonitor: "margins",
    VirtualFrame: "orientation",
    Plant: "advance",
}


@pytest.fixture
def calls(monkeypatch):
    """Return the calls of some methods, which run as ever: method, object and arguments."""
    made = []

    def watched(method):
        def call(self, *arguments):
            made.append((method.__name__, self, arguments))
            return method(self, *arguments)

        return call

    for owner, name in WATCHED.items():
        monkeypatch.setattr(owner, name, watched(getattr(owner, name)))
    return made


def test_every_block_runs_with_contacts_that_stick_and_with_some_that_slip(calls):
    warm_up.run_every_block()
    runs = [(loop.scenario.name, *ticks) for name, loop, ticks in calls if name == "run"]
    assert runs == [("paper", 3), ("pull", 3)]
    assert "margins" in {name for name, *_ in calls}
    ((stamp, contacts, *four),) = [arguments for name, _, arguments in calls if name == "note"]
    assert [len(each) for each in (contacts.positions, *four)] == [4] * 5
    assert max(len(points[0]) for name, _, points in calls if name == "orientation") == 4
    _, plant, (torque,) = calls[-1]  # the last tick: nothing rubs any more
    assert not plant.friction.any() and torque.any()
    assert np.abs(plant.state.sliding).max() > 0.0


@pytest.mark.parametrize("complete", [False, True])
def test_it_is_done_once_for_the_same_sources(complete, monkeypatch):
    done = []
    monkeypatch.setattr(warm_up, "is_complete", lambda: complete)
    monkeypatch.setattr(warm_up, "run_every_block", lambda: done.append("run"))
    monkeypatch.setattr(warm_up, "mark_complete", lambda: done.append("marked"))
    warm_up.warm_up()
    assert done == ([] if complete else ["run", "marked"])
