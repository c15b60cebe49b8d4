# SPDX-License-Identifier: Apache-2.0
"""Events are found at the right ticks."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import serialize_message

from tactile_hand_ros.bag.reader import TopicMessages
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.ros.messages import PushCodec
from tactile_hand_ros.run.events import (
    Asked,
    Event,
    alarm_count,
    asked_events,
    events,
    read_asked,
    read_pushes,
    slip_count,
)
from tactile_hand_ros.scenario.scenario import load_scenario


@pytest.fixture
def record() -> Record:
    """Return an uneventful second at 100 Hz: all contacts stick."""
    out = Record.empty(101, ["thumb", "ring_finger"], ["a"])
    out.stamps[:] = 10_000_000 * np.arange(101)
    for array in (out.contact_positions, out.forces, out.true_sliding, out.desired_position):
        array[:] = 0.0
    out.desired_quaternion[:] = [0.0, 0.0, 0.0, 1.0]
    out.grip[:] = ContactState.STICK
    out.grasp_force[:] = 10.0
    return out


def told(record: Record, kind: str) -> list[tuple[float, str]]:
    return [(e.time, e.finger) for e in events(record) if e.kind == kind]


def test_a_quiet_run_has_its_first_command_only(record):
    assert events(record) == [Event(0.0, "command", "", "a new pose is commanded")]


def test_each_event_has_its_tick_and_finger(record):
    record.desired_position[:10] = np.nan
    record.desired_position[70:] = [0.0, 0.1, 0.0]
    record.true_sliding[30:40, 0] = 0.002
    record.grip[33:38, 0] = ContactState.SLIP
    record.grasp_force[35:] = 12.0
    record.contact_positions[50:60, 1] = np.nan
    assert [(round(100 * e.time), e.kind, e.finger) for e in events(record)] == [
        (10, "command", ""),
        (30, "slip", "thumb"),
        (33, "detection", "thumb"),
        (35, "reaction", ""),
        (50, "contact_lost", "ring_finger"),
        (60, "contact_made", "ring_finger"),
        (70, "command", ""),
    ]
    assert "ring finger loses contact" in [e.text for e in events(record)]


def test_slip_is_faster_than_a_millimetre_a_second(record):
    record.true_sliding[30:40, 0] = 1e-3
    assert told(record, "slip") == [] and slip_count(record) == 0
    record.true_sliding[30:40, 0] = record.true_sliding[60:70, 1] = np.nextafter(1e-3, 1.0)
    assert [finger for _, finger in told(record, "slip")] == ["thumb", "ring_finger"]
    assert slip_count(record) == 2


@pytest.mark.parametrize(("pause", "count"), [(1, 1), (2, 1), (3, 2)])
def test_what_begins_again_within_20_ms_is_the_same(record, pause, count):
    record.stamps[:] = 2**23 * np.arange(101)  # 8.4 ms, so that 20 ms lie between ticks
    record.grip[20:25, 1] = record.grip[25 + pause : 40, 1] = ContactState.SLIP
    assert len(told(record, "detection")) == alarm_count(record) == count


def test_alarms_of_all_fingers_are_counted(record):
    record.grip[20:25, 0] = record.grip[22:30, 1] = record.grip[60, 0] = ContactState.SLIP
    assert alarm_count(record) == 3
    # Events at the first tick do not count as new; one right after it is the same event.
    record.grip[[0, 2], 1] = ContactState.SLIP
    assert alarm_count(record) == 3


@pytest.mark.parametrize(
    ("row", "force", "count"),
    [(33, 12.0, 1), (58, 12.0, 1), (59, 12.0, 0), (40, 10.2, 0), (40, 10.21, 1)],
)
def test_a_reaction_is_a_rise_by_two_percent_within_a_quarter_second(record, row, force, count):
    record.grip[33:38, 0] = ContactState.SLIP
    record.grasp_force[row:] = force
    found = [each for each in events(record) if each.kind == "reaction"]
    assert [each.time for each in found] == [pytest.approx(0.01 * row)] * count
    assert all(each.text == "the grasp force rises above 10 N" for each in found)


def test_a_contact_that_was_lost_in_the_dark_is_lost_when_touch_is_back(record):
    """Before touch has reported anything, no contact is lost."""
    record.contact_positions[:3] = record.forces[:3] = np.nan
    record.contact_positions[50:60] = record.forces[50:60] = np.nan
    record.contact_positions[60:, 1] = np.nan
    assert told(record, "contact_lost") == [(pytest.approx(0.6), "ring_finger")]
    assert told(record, "contact_made") == []
    assert told(record, "gap") == [(pytest.approx(0.49), "")]
    text = next(each.text for each in events(record) if each.kind == "gap")
    assert text == "no data was recorded for 0.11 s"


def test_a_drop_and_pushes_stand_in_their_order(record):
    pushes = [
        {"kind": "step", "start": 0.5, "force": [0.0, 0.0, 0.0], "torque": [0.0, 0.6, 0.8]},
        {"kind": "step", "start": 0.25, "force": [2.0, 0.0, 0.0], "torque": [0.5, 0.0, 0.0]},
        {"kind": "step", "start": 0.95, "force": [0.0, 0.0, 0.0]},
        {"kind": "step", "start": 3.5, "force": [0.0, 0.0, 0.0]},  # the run ended before
    ]
    changed = {
        "plant.disturbances": pushes,
        "plant.friction_changes": [{"start": 0.9, "friction": 0.2}],
        "duration": 4.0,
    }
    found = events(record, load_scenario("pull", changed), dropped=0.75)
    assert [(each.time, each.text) for each in found] == [
        (0.0, "a new pose is commanded"),
        (0.25, "step of 2 N and 0.5 N m"),
        (0.5, "step of 1 N m"),
        (0.75, "the object is dropped"),
        (0.9, "friction becomes 0.2"),
        (0.95, "step of 0 N"),
    ]
    cut_short = events(record, load_scenario("pull", {"duration": 4.0}))
    assert not [each for each in cut_short if each.kind == "disturbance"]


def test_calls_and_refusals_are_told_with_what_was_asked():
    calls = [Asked(0, "enable", "true"), Asked(0, "reset", ""), Asked(2 * 10**9, "enable", "false")]
    refusals = [Asked(5 * 10**8, "desired_pose", "out of reach")]
    assert asked_events(calls, refusals) == [
        Event(0.0, "request", "", "a user calls reset"),
        Event(2.0, "request", "", "a user calls enable (false)"),
        Event(0.5, "refusal", "", "desired_pose is rejected: out of reach"),
    ]


@pytest.mark.parametrize("status", [[], [DiagnosticStatus()]])
def test_a_request_that_names_nothing_is_a_broken_bag(status) -> None:
    data = serialize_message(DiagnosticArray(status=status))
    with pytest.raises(BagError, match="expected a key and its value"):
        read_asked(TopicMessages([0], [data]))


def test_pushes_of_users_are_told_with_their_largest_force() -> None:
    codec, data = PushCodec(), []
    for tick, force in enumerate([0.0, 1.5, 5.0, 2.0, 0.0, 0.0, 0.5]):
        data.append(codec.encode(np.array([0.6 * force, 0.0, -0.8 * force, 9.0, 0.0, 0.0]), tick))
    found = read_pushes(TopicMessages([0] * 7, data))
    told = [(round(1e9 * e.time), e.kind, e.text) for e in found]
    assert told == [
        (1, "disturbance", "a user pushes with up to 5.0 N"),
        (6, "disturbance", "a user pushes with up to 0.5 N"),
    ]
    assert read_pushes(TopicMessages([], [])) == []
    with pytest.raises(BagError, match="push"):
        read_pushes(TopicMessages([0], [b"rubbish"]))
