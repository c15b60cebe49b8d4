# SPDX-License-Identifier: Apache-2.0
"""Rows of a picture and events, from batches of messages with known numbers."""

from collections.abc import Sequence

import numpy as np
import pytest

from tactile_hand_ros import names
from tactile_hand_ros.cockpit.events import Watch
from tactile_hand_ros.cockpit.picture import KEPT, ROWS_PER_BATCH, Picture
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.ros.messages import (
    ContactsCodec,
    ImuCodec,
    JointCodec,
    PoseCodec,
    WrenchCodec,
)

FINGERS = ("finger_1", "finger_2")
MS = 1_000_000
Batch = dict[str, list[bytes]]


def batch(
    *ticks: int,
    slip: Sequence[float] = (0.0, 0.0),
    grip: int = ContactState.STICK,
    force: float = 10.0,
    torque: float = 0.5,
) -> Batch:
    """Return the messages of some ticks, ms; of finger 2 only, the alarm is `grip`."""
    found: Batch = {}
    joints = JointCodec(["a", "b", "c"], ("position", "velocity", "effort"))
    of_fingers = JointCodec(FINGERS, ("position", "velocity", "effort"))
    turn = np.array([0.0, 0.0, 0.6, 0.8])
    for tick in ticks:
        stamp, still = tick * MS, np.zeros(2)
        state = of_fingers.encode(stamp, np.array([0.4, 0.5]), still, np.array([1.0, grip]))
        sliding = of_fingers.encode(stamp, still, np.array(slip), still)
        places = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
        messages = {
            names.JOINT_STATES: joints.encode(
                stamp,
                np.array([0.1, 0.2, 0.3]),
                np.array([1.0, 2.0, 1e-3 * tick]),
                np.full(3, torque),
            ),
            names.CONTACTS: ContactsCodec(2).encode(places, np.tile(turn, (2, 1)), stamp),
            names.GRASP_FORCE: WrenchCodec("palm").encode([0.0, force, 0.0], stamp),
            names.GRIP_STATE: state,
            names.TRUE_SLIP: sliding,
            names.IMU: ImuCodec().encode(np.array([0.6, 0.0, 0.8, 0.0]), stamp),
            names.AUXILIARY_POSE: PoseCodec().encode(np.array([1.0, 2.0, 3.0]), turn, stamp),
        }
        for i, name in enumerate(FINGERS):
            codec = WrenchCodec(names.contact_frame(name))
            messages[names.wrench(name)] = codec.encode([3.0, 5.0 + i, 4.0], stamp)
            messages[names.optimal_force(name)] = codec.encode([0.0, 0.3 + 0.4 * i, 0.0], stamp)
        for topic, data in messages.items():
            found.setdefault(topic, []).append(data)
    return found


def take(picture: Picture, messages: Batch) -> list[str]:
    """Read a batch, make rows, and return the errors."""
    errors = [str(error) for error in picture.take(messages)]
    picture.advance()
    return errors


def shown(picture: Picture, column: str) -> np.ndarray:
    """Return a column of all rows, shape (n, width)."""
    at = 0
    for name, width in picture.columns.items():
        if name == column:
            return picture.since(0)[2][:, at : at + width]
        at += width
    raise KeyError(column)


@pytest.fixture
def picture() -> Picture:
    made = Picture(FINGERS, ("a", "b", "c"), 0)
    made.desired = np.array([1.0, 2.0, 3.5, 0.0, 0.0, 0.0, 1.0])
    return made


def test_a_row_has_the_numbers_of_its_tick(picture: Picture) -> None:
    assert take(picture, batch(2, 4)) == []
    total, times, _ = picture.since(0)
    assert (total, times.tolist()) == (2, [0.002, 0.004])
    known = {
        "theta": [0.1, 0.2, 0.3],
        "rates": [1.0, 2.0, 0.004],
        "contact_positions": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        "contact_quaternions": [0.0, 0.0, 0.6, 0.8] * 2,
        "position_error": [0.5],
        "rotation_error": [2.0 * 2.0 * 0.6 * 0.8],  # twice the sine of twice the half angle
        "force": [3.0, 5.0, 4.0, 3.0, 6.0, 4.0],
        "expected": [3.0, 7.0],
        "beta": [1.0, 5.0 / 6.0],
        "friction": [0.4, 0.5],
        "grip": [1.0, 1.0],
        "grasp_force": [10.0],
        "push": [0.0] * 6,
        "palm": [0.6, 0.0, 0.8, 0.0],
    }
    for name, values in known.items():
        np.testing.assert_allclose(shown(picture, name)[-1], values, rtol=1e-6, err_msg=name)
    assert np.isnan(shown(picture, "object_position")).all()  # no ground truth


def test_rows_wait_for_a_topic_that_still_comes_and_not_for_a_dead_one(
    picture: Picture, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    first, late = batch(2), batch(4, 6)
    touch = {names.CONTACTS: late.pop(names.CONTACTS)}
    assert take(picture, first) + take(picture, late) == []
    assert picture.total == 1  # the touch of 4 and 6 ms may be on its way
    assert take(picture, touch) == []
    assert picture.since(0)[1].tolist() == [0.002, 0.004, 0.006]
    now[0] += 1.0
    late = batch(100)
    late.pop(names.CONTACTS)
    assert take(picture, late) == []
    assert np.isnan(shown(picture, "contact_positions")[-1]).all()
    assert np.isfinite(shown(picture, "theta")[-1]).all()


def test_many_ticks_become_few_rows_with_the_newest_among_them(picture: Picture) -> None:
    assert take(picture, batch(*range(1, 101))) == []
    assert picture.total == ROWS_PER_BATCH
    assert picture.since(0)[1][-1] == pytest.approx(0.1)
    for start in range(1, 2 * KEPT // ROWS_PER_BATCH):
        take(picture, batch(*range(100 * start + 1, 100 * start + 5)))
    total, times, rows = picture.since(0)
    assert total > KEPT == len(times) == len(rows)
    assert (np.diff(times) > 0.0).all()
    assert len(picture.since(total - 3)[1]) == 3


def test_what_came_before_time_was_set_back_is_not_shown(picture: Picture) -> None:
    take(picture, batch(504, 0, 2))
    assert picture.since(0)[1].tolist() == [0.0, 0.002]


def test_a_message_of_another_type_is_rejected_and_the_rest_is_shown(picture: Picture) -> None:
    broken = batch(2) | {names.AUXILIARY_POSE: [b"\x00\x01\x00\x00rubbish"]}
    (error,) = take(picture, broken)
    assert names.AUXILIARY_POSE in error
    longer = bytearray(batch(4)[names.JOINT_STATES][0])
    at = longer.index(b"\x03\0\0\0", longer.index(b"c\0"))  # the number of angles
    longer[at] = 4
    (error,) = take(picture, {names.JOINT_STATES: [bytes(longer)]})
    wider = JointCodec(["a"], ("position", "velocity", "effort"))
    narrow = {names.JOINT_STATES: [wider.encode(4 * MS, *[np.zeros(1)] * 3)]}
    (error,) = take(picture, narrow)
    assert "3 numbers, expected 9" in error
    assert picture.total == 1


def test_the_course_of_a_slip_in_milliseconds(picture: Picture) -> None:
    watch, events = Watch(), []
    for messages in (
        batch(0, 2),
        batch(4, 6, slip=(0.0, 0.01)),
        batch(8, slip=(0.0, 0.02), grip=ContactState.SLIP),
        batch(9, grip=ContactState.SLIP),  # too short a pause for a second slip
        batch(10, slip=(0.0, 0.02), grip=ContactState.SLIP, force=12.0),
        batch(12, 30, 34, force=12.0, torque=0.6),
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
    take(picture, batch(36, slip=(0.0, 0.01)))  # a pause of 26 ms: the next slip
    assert [event[1] for event in watch.step(picture)] == ["slip"]


def test_an_alarm_that_arrives_before_its_slip_belongs_to_it(picture: Picture) -> None:
    """Nodes send their batches at different moments."""
    watch, first = Watch(), batch(0, 2)
    take(picture, first)
    assert list(watch.step(picture)) == []
    whole = batch(4, slip=(0.01, 0.0), grip=ContactState.SLIP, force=11.0)
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
    for messages in (batch(0), batch(4, grip=ContactState.SLIP), batch(30, force=20.0)):
        messages.pop(names.TRUE_SLIP)
        take(picture, messages)
        list(watch.step(picture))
    known = {"at": 0.004, "finger": "finger_2", "reaction": 26.0, "stuck": 0.0}
    assert watch.response == known
