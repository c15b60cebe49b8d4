# SPDX-License-Identifier: Apache-2.0
"""What the fault node does to the bytes of a message."""

import random

import numpy as np
import pytest

from studies.faults import space, taps
from tactile_hand_ros import names
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.ros.messages.wire import ContactsCodec, JointCodec, WrenchCodec

JOINTS = JointCodec(["a", "b"], ("position", "velocity", "effort"))
FINGERS = ["finger_1", "finger_2", "finger_3"]
OLD = JOINTS.encode(7, np.ones(2), np.ones(2), np.ones(2))
NEW = JOINTS.encode(10**9 + 9, np.zeros(2), np.zeros(2), np.zeros(2))


def test_a_stuck_message_has_new_stamps_and_old_values():
    stamp, (position, _, _) = JOINTS.decode(taps.stuck(NEW, OLD))
    assert stamp == 10**9 + 9
    np.testing.assert_array_equal(position, np.ones(2))


def test_a_clock_that_steps_is_an_hour_ahead():
    stamp, values = JOINTS.decode(taps.stepped(NEW))
    assert stamp == 10**9 + 9 + 3600 * 10**9
    np.testing.assert_array_equal(values, np.zeros((3, 2)))


def test_garbage_keeps_stamp_and_length_and_is_refused():
    spoiled = taps.garbage(OLD, random.Random(1))
    assert len(spoiled) == len(OLD) and spoiled[:12] == OLD[:12]
    with pytest.raises(MessageError):
        JOINTS.decode(spoiled)


def test_wrong_values_can_be_read():
    kinds = {
        topic: kind
        for tap in ("joints", "touch", "forces")
        for topic, (_, kind) in taps.tapped(tap, FINGERS).items()
    }
    stamp, (position, _, effort) = JOINTS.decode(taps.wrong(OLD, kinds[names.JOINT_STATES]))
    assert stamp == 7 and (position > 1.0).all() and (effort == -1.0).all()
    force = WrenchCodec("tip")
    _, value = force.decode(taps.wrong(force.encode(np.ones(3), 7), kinds[names.GRASP_FORCE]))
    np.testing.assert_allclose(value, [-3.0, 3.0, -3.0])
    contacts = ContactsCodec(3)
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    spoiled = taps.wrong(contacts.encode(np.eye(3), turns, 7), kinds[names.CONTACTS])
    np.testing.assert_allclose(contacts.decode(spoiled)[1][0][:, 0], [1.02, 0.02, 0.02])


def test_each_component_with_a_tap_has_topics_in_it():
    for cell in space.cells():
        if cell.is_signal:  # which needs no tap
            continue
        topics = taps.topics_of(cell.component, FINGERS)
        assert set(topics) <= set(taps.tapped(cell.tap, FINGERS))
        assert bool(topics) == bool(cell.tap)
