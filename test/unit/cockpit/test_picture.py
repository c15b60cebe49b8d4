# SPDX-License-Identifier: Apache-2.0
"""Rows of a picture and events, from batches of messages with known numbers."""

from typing import Any

import numpy as np
import pytest
from support.messages import joint_message, serialized
from support.recorded import random_record, write_tick

from tactile_hand_ros import names
from tactile_hand_ros.cdr import packed
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.cockpit.events import Watch
from tactile_hand_ros.cockpit.picture import ROWS_PER_BATCH, Picture
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.report.document import plot_columns, scene_columns
from tactile_hand_ros.run.result import RunData

MS = 1_000_000
SLIPS = {"grip": (ContactState.STICK, ContactState.SLIP, ContactState.STICK)}


class Batch(dict[str, list[bytes]]):
    """The messages of a record by topic."""

    def __init__(self, record: Record) -> None:
        for row in range(len(record)):
            write_tick(self, record, row, 0)

    def write(self, topic: str, content: Any, _: int) -> None:
        self.setdefault(topic.removeprefix("/"), []).append(serialized(content))


def batch(*ticks: int, **arrays: Any) -> Batch:
    """Return the messages of some ticks, ms, of which some arrays have a value."""
    record = random_record(len(ticks))
    record.stamps[:] = MS * np.array(ticks)
    still = {"true_sliding": 0.0, "grip": ContactState.STICK, "grasp_force": 10.0, "torque": 0.5}
    for name, value in {**still, **arrays}.items():
        getattr(record, name)[:] = value
    return Batch(record)


def take(picture: Picture, messages: dict[str, list[bytes]]) -> list[str]:
    """Read a batch, make rows, and return the errors."""
    batch = {topic: packed(each) for topic, each in messages.items()}
    errors = [str(error) for error in picture.take(batch)]
    picture.advance()
    return errors


def shown(picture: Picture, column: str) -> np.ndarray:
    """Return a column of all rows, shape (n, width)."""
    ends = np.cumsum(list(picture.columns.values()))
    parts = np.split(picture.since(0)[2], ends[:-1], axis=1)
    return parts[list(picture.columns).index(column)]


@pytest.fixture
def picture() -> Picture:
    record = random_record(1)
    return Picture(record.finger_names, record.joint_names, 0)


def test_a_row_has_the_numbers_of_a_report(picture: Picture) -> None:
    record = random_record(ROWS_PER_BATCH)
    pose = record.desired_position[0], record.desired_quaternion[0]
    picture.desired = np.concatenate(pose)
    assert take(picture, Batch(record)) == []
    total, times, _ = picture.since(0)
    assert total == len(record) and times.tolist() == record.times.tolist()
    known = plot_columns(RunData(record, None)) | scene_columns(record)
    assert picture.columns.keys() - known.keys() == {"push", "palm"}
    for name in picture.columns.keys() & known.keys():
        expected = known[name].reshape(total, -1)
        np.testing.assert_allclose(shown(picture, name), expected, rtol=1e-6, err_msg=name)
    assert (shown(picture, "push") == 0.0).all() and np.isnan(shown(picture, "palm")).all()


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the time of the wall clock."""
    shown = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: shown[0])
    return shown


def test_rows_wait_for_a_topic_that_still_comes_and_not_for_a_dead_one(picture, now) -> None:
    first, late = batch(2), batch(4, 6)
    touch = {names.CONTACTS: late.pop(names.CONTACTS)}
    assert take(picture, first) + take(picture, late) == []
    assert picture.total == 1  # the touch of 4 and 6 ms may be on its way
    assert take(picture, touch) == []
    assert picture.since(0)[1].tolist() == [0.002, 0.004, 0.006]
    for stamp in (100, 200, 300):
        now[0] += 0.15
        late = batch(stamp)
        late.pop(names.CONTACTS)
        assert take(picture, late) == []
    assert np.isnan(shown(picture, "contact_positions")[-1]).all()
    assert np.isfinite(shown(picture, "theta")[-1]).all()


def test_after_a_pause_a_row_waits_for_all_topics_again(picture, now) -> None:
    watch = Watch()
    take(picture, batch(2))
    assert list(watch.step(picture)) == []
    now[0] += 60.0
    step = batch(4, **SLIPS)
    touch = {names.GRIP_STATE: step.pop(names.GRIP_STATE)}
    take(picture, step)
    assert picture.total == 1 and list(watch.step(picture)) == []
    take(picture, touch)
    assert picture.total == 2
    assert [event[1] for event in watch.step(picture)] == ["detection"]


def test_many_ticks_become_few_rows_with_the_newest_among_them(monkeypatch, picture) -> None:
    monkeypatch.setattr("tactile_hand_ros.cockpit.picture.KEPT", 10)
    for start in range(4):
        assert take(picture, batch(*range(100 * start + 1, 100 * start + 21))) == []
        assert picture.total == (start + 1) * ROWS_PER_BATCH
        assert picture.since(0)[1][-1] == pytest.approx(0.1 * start + 0.02)
    total, times, rows = picture.since(0)
    assert total > 10 == len(times) == len(rows)
    assert (np.diff(times) > 0.0).all()
    assert len(picture.since(total - 3)[1]) == 3


def test_what_came_before_time_was_set_back_is_not_shown(picture: Picture) -> None:
    take(picture, batch(504, 0, 2))
    take(picture, batch(600))
    assert picture.since(0)[1] == pytest.approx([0.0, 0.002, 0.6])


def test_a_message_of_another_type_is_rejected_and_the_rest_is_shown(picture: Picture) -> None:
    broken = batch(2) | {names.AUXILIARY_POSE: [b"\x00\x01\x00\x00rubbish"]}
    (error,) = take(picture, broken)
    assert names.AUXILIARY_POSE in error
    longer = bytearray(batch(4)[names.JOINT_STATES][0])
    at = longer.index(b"\x09\0\0\0", longer.index(b"joint_9\0"))  # the number of angles
    longer[at] = 10
    (error,) = take(picture, {names.JOINT_STATES: [bytes(longer)]})
    one = joint_message(["a"], 4 * MS, position=[0.0], velocity=[0.0], effort=[0.0])
    (error,) = take(picture, {names.JOINT_STATES: [serialized(one)]})
    assert "3 numbers, expected 27" in error
    assert picture.total == 1


def test_the_course_of_a_slip_in_milliseconds(picture: Picture) -> None:
    watch, events = Watch(), []
    for messages in (
        batch(0, grasp_force=20.0),
        batch(2),
        batch(4, 6, true_sliding=(0.0, 0.01, 0.0)),
        batch(8, true_sliding=(0.0, 0.02, 0.0), **SLIPS),
        batch(9, **SLIPS),  # too short a pause for a second slip
        batch(10, true_sliding=(0.0, 0.02, 0.0), grasp_force=12.0, **SLIPS),
        batch(12, 30, 34, grasp_force=12.0, torque=0.6),
    ):
        take(picture, messages)
        events += list(watch.step(picture))
    assert [event[:3] for event in events] == [
        (4 * MS, "slip", "finger_2"),
        (8 * MS, "detection", "finger_2"),
        (10 * MS, "reaction", ""),
    ]
    known = {"detection": 4.0, "reaction": 6.0, "torque": 8.0, "stuck": 6.0}
    assert watch.response == {"at": 0.004, "finger": "finger_2"} | known
    take(picture, batch(36, true_sliding=(0.0, 0.01, 0.0)))  # a pause of 26 ms: the next slip
    assert [event[1] for event in watch.step(picture)] == ["slip"]
    assert watch.response["at"] == pytest.approx(0.036)


def test_an_alarm_that_arrives_before_its_slip_belongs_to_it(picture: Picture) -> None:
    """Nodes send their batches at different moments."""
    watch, first = Watch(), batch(0, 2)
    take(picture, first)
    assert list(watch.step(picture)) == []
    whole = batch(4, true_sliding=(0.01, 0.0, 0.0), grasp_force=11.0, **SLIPS)
    truth = {names.TRUE_SLIP: whole.pop(names.TRUE_SLIP)}
    take(picture, whole)
    assert list(watch.step(picture)) == []
    take(picture, truth)
    kinds = [event[1] for event in watch.step(picture)]
    assert kinds == ["slip", "detection", "reaction"]
    known = {"at": 0.004, "finger": "finger_1", "detection": 0.0, "reaction": 0.0}
    assert watch.response == known


def test_without_ground_truth_a_response_starts_with_the_alarm(picture: Picture) -> None:
    watch = Watch()
    for messages in (batch(0), batch(4, **SLIPS), batch(30, grasp_force=20.0)):
        messages.pop(names.TRUE_SLIP)
        take(picture, messages)
        list(watch.step(picture))
    known = {"at": 0.004, "finger": "finger_2", "reaction": 26.0, "stuck": 0.0}
    assert watch.response == known
