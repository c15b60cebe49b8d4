# SPDX-License-Identifier: Apache-2.0
"""A link inside the object is found after a run, in numbers, events and tables."""

import sys

import numpy as np
import pytest
from support.hands import changed, prism_grasp

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.report.tables import metrics_rows
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.scenario.scenario import load_scenario

LINKS = ("palm", "f1_tip")
BOX = '<collision><geometry><box size="0.1 0.1 0.02"/></geometry></collision>'


@pytest.fixture
def run(tmp_path):
    """Return a run of 1 s in which a prism, half of which is 120 mm, sinks by 0.4 m/s."""
    changes = prism_grasp(tmp_path, [3, 3, 3]) | {"targets": [], "duration": 1.0}
    boxes = [(f'<link name="{name}"/>', f'<link name="{name}">{BOX}</link>') for name in LINKS]
    changed(tmp_path / "hand.yaml", *boxes)
    scenario = load_scenario("gravity", changes)
    joints = [f"f{i}_joint_{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    record = Record.empty(1001, ["f1", "f2", "f3"], joints)
    record.stamps[:] = 1_000_000 * np.arange(1001)
    record.theta[:] = scenario.plant.initial_joints
    record.object_position[:] = [0.0, 0.0, 0.4]
    record.object_position[:, 2] -= 0.4 * record.times
    record.object_quaternion[:] = [0.0, 0.0, 0.0, 1.0]
    return RunData(record, scenario)


def test_the_palm_is_found_when_the_object_reaches_it(run):
    """At 0.675 s; looks are 50 ms apart, and the tip that touches from the start does not count."""
    m = run.metrics
    assert (m.link_inside, m.link_inside_s) == ("palm", pytest.approx(0.7))
    assert ["link inside the object", "palm from 0.7 s"] in metrics_rows(m)
    event = next(each for each in run.events if each.finger == "palm")
    assert (event.time, event.kind) == (m.link_inside_s, "contact_made")
    assert event.text == "palm comes inside the object"


def test_without_ground_truth_or_a_hand_there_is_none(run, tmp_path):
    run.record.object_position[:600] = np.nan
    assert run.metrics.link_inside_s == pytest.approx(0.7)
    unseen = RunData(run.record, run.scenario)
    unseen.record.object_position[:] = np.nan
    assert unseen.metrics.link_inside == ""
    (tmp_path / "hand.urdf").unlink()
    lost = RunData(run.record, run.scenario)
    assert lost.metrics.link_inside == "" and np.isnan(lost.metrics.link_inside_s)


def test_without_the_library_that_reads_meshes_the_other_metrics_remain(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    mesh = {"vertices": [], "mesh": "mug.stl"}
    body = {f"plant.object.{name}": value for name, value in mesh.items()}
    m = RunData(run.record, run.scenario.changed(body)).metrics
    assert (m.ticks, m.link_inside) == (1001, "") and np.isnan(m.link_inside_s)
