# SPDX-License-Identifier: Apache-2.0
"""Events are found at the ticks at which they happened."""

from __future__ import annotations

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.closed_loop.scenario import load_scenario
from tactile_hand_ros.control.slip.detector import Grip
from tactile_hand_ros.run.events import Event, events


@pytest.fixture
def record() -> Record:
    """Return a quiet second at 100 Hz: everything touches and sticks."""
    out = Record.empty(101, ["thumb", "ring_finger"], ["a"])
    out.stamps[:] = 10_000_000 * np.arange(101)
    for array in (out.contact_positions, out.forces, out.true_sliding, out.desired_position):
        array[:] = 0.0
    out.desired_quaternion[:] = [0.0, 0.0, 0.0, 1.0]
    out.grip[:] = Grip.STICK
    out.grasp_force[:] = 10.0
    return out


def told(record: Record, kind: str) -> list[tuple[float, str]]:
    return [(e.time, e.finger) for e in events(record) if e.kind == kind]


def test_a_quiet_run_has_its_first_command_only(record: Record) -> None:
    assert events(record) == [Event(0.0, "command", "", "a new pose is commanded")]


def test_slip_its_detection_and_the_reaction(record: Record) -> None:
    record.true_sliding[30:40, 0] = 0.002
    record.grip[33:38, 0] = Grip.SLIP
    record.grasp_force[35:] = 12.0
    assert told(record, "slip") == [(pytest.approx(0.30), "thumb")]
    assert told(record, "detection") == [(pytest.approx(0.33), "thumb")]
    assert told(record, "reaction") == [(pytest.approx(0.35), "")]


def test_creep_is_no_slip_and_an_alarm_without_answer_no_reaction(record: Record) -> None:
    record.true_sliding[30:, 0] = 0.0009
    record.grip[33:38, 0] = Grip.SLIP
    assert told(record, "slip") == []
    assert told(record, "reaction") == []


def test_a_flickering_alarm_is_one(record: Record) -> None:
    record.grip[[20, 22, 24], 1] = Grip.SLIP
    record.grip[60, 1] = Grip.SLIP
    assert [time for time, _ in told(record, "detection")] == pytest.approx([0.2, 0.6])


def test_contacts_lost_and_made(record: Record) -> None:
    record.contact_positions[50:60, 1] = np.nan
    assert told(record, "contact_lost") == [(pytest.approx(0.5), "ring_finger")]
    assert told(record, "contact_made") == [(pytest.approx(0.6), "ring_finger")]
    text = next(e.text for e in events(record) if e.kind == "contact_lost")
    assert text == "ring finger loses contact"


def test_missing_messages_are_no_lost_contact(record: Record) -> None:
    record.contact_positions[50:60] = record.forces[50:60] = np.nan
    assert told(record, "contact_lost") == []


def test_new_poses(record: Record) -> None:
    record.desired_position[:10] = np.nan
    record.desired_position[70:] = [0.0, 0.1, 0.0]
    assert [time for time, _ in told(record, "command")] == pytest.approx([0.1, 0.7])


def test_without_truth_there_are_no_slips(record: Record) -> None:
    record.true_sliding[:] = np.nan
    assert told(record, "slip") == []


def test_disturbances_come_from_the_scenario(record: Record) -> None:
    pushes = [{"kind": "step", "start": 2.0, "force": [0.0, 3.0, 4.0]}]
    changes = [{"start": 1.0, "friction": 0.2}]
    scenario = load_scenario(
        "pull", {"plant.disturbances": pushes, "plant.friction_changes": changes}
    )
    found = [(e.time, e.text) for e in events(record, scenario) if e.kind == "disturbance"]
    assert found == [(1.0, "friction becomes 0.2"), (2.0, "step of 5 N")]
