# SPDX-License-Identifier: Apache-2.0
"""Decoding a whole topic at once equals a general decoder message by message."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.messages import contacts_message, force_message, joint_message, serialized

from tactile_hand_ros.cdr import BatchReader, packed, tables, unpacked
from tactile_hand_ros.errors import MessageError

WRENCH = "geometry_msgs/msg/WrenchStamped"
JOINTS = "sensor_msgs/msg/JointState"
POSES = "geometry_msgs/msg/PoseArray"

names = st.text("abc_1", max_size=9)
stamps = st.integers(0, 2**31 * 10**9 - 1)


@settings(max_examples=50)
@given(st.lists(st.tuples(stamps, names, st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3))))
def test_wrenches(given):
    """With any frame names: their lengths shift the numbers."""
    messages = [serialized(force_message(force, stamp, frame)) for stamp, frame, force in given]
    seen = 0
    for table in tables(WRENCH, messages):
        for i, row in enumerate(table.rows):
            stamp, frame, force = given[row]
            assert table.layout.texts == [frame]
            assert table.stamps[i] == stamp
            assert table.doubles("wrench")[i].tolist() == [*force, 0.0, 0.0, 0.0]
            seen += 1
    assert seen == len(messages)


@settings(max_examples=50)
@given(st.lists(names, max_size=4), st.booleans(), st.booleans(), st.booleans())
def test_joint_states(joints, position, velocity, effort):
    values = np.arange(1.0, len(joints) + 1.0)
    present = {"position": position, "velocity": velocity, "effort": effort}
    fields = {name: values * 10.0 for name, there in present.items() if there}
    [table] = tables(JOINTS, [serialized(joint_message(joints, 7, **fields))] * 2)
    assert table.layout.texts == ["", *joints]
    for name, there in present.items():
        expected = (values * 10.0).tolist() if there else []
        assert table.doubles(name).tolist() == [expected, expected]


def test_messages_with_other_strings_of_the_same_length_are_kept_apart():
    first = joint_message(["a", "b"], 1, position=[1.0, 2.0])
    other = joint_message(["b", "a"], 2, position=[3.0, 4.0])
    found = list(tables(JOINTS, [serialized(m) for m in (first, other, first)]))
    assert [(t.rows.tolist(), t.layout.texts) for t in found] == [
        ([0, 2], ["", "a", "b"]),
        ([1], ["", "b", "a"]),
    ]


def test_the_options_of_an_encoding_do_not_matter():
    message = serialized(force_message((1.0, 2.0, 3.0), 3, "abcd"))
    [table] = tables(WRENCH, [message, message[:2] + b"\7\7" + message[4:]])
    assert table.stamps.tolist() == [3, 3]
    assert table.doubles("wrench")[:, :3].tolist() == [[1.0, 2.0, 3.0]] * 2


def test_arrays_of_poses_may_change_their_length():
    point, turn = (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)
    messages = [serialized(contacts_message([point] * k, [turn] * k, 0)) for k in (0, 2, 1)]
    found = {int(t.rows[0]): t.doubles("poses").tolist() for t in tables(POSES, messages)}
    assert found == {0: [[]], 1: [[*point, *turn] * 2], 2: [[*point, *turn]]}


@pytest.mark.parametrize("size", [0, 3, 8, 15, 30, -1])
def test_truncated_message(size):
    message = serialized(joint_message(["a", "b"], 1, position=[1.0, 2.0]))
    with pytest.raises(MessageError, match="not a sensor_msgs/msg/JointState"):
        list(tables(JOINTS, [message[:size]]))


def test_length_beyond_the_end():
    message = bytearray(serialized(joint_message(["a"], 1, position=[1.0])))
    message[20:24] = struct.pack("<I", 2**32 - 1)
    with pytest.raises(MessageError, match="announced"):
        list(tables(JOINTS, [bytes(message)]))


@pytest.mark.parametrize("encoding", ["0007", "0002", "0100", "0101", "0000"])
def test_foreign_encoding(encoding):
    message = bytes.fromhex(encoding) + serialized(force_message((1.0, 2.0, 3.0), 1))[2:]
    with pytest.raises(MessageError, match=f"encoding {encoding}"):
        list(tables(WRENCH, [message]))


wrenches = st.tuples(stamps, names, st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3))


@settings(max_examples=50)
@given(st.lists(st.lists(wrenches, min_size=1), min_size=1))
def test_batches_are_read_in_order_whatever_their_layouts(batches):
    read = BatchReader(WRENCH, {"wrench": 3})
    for batch in batches:
        sent = [serialized(force_message(force, stamp, frame)) for stamp, frame, force in batch]
        times, numbers = read(packed(sent))
        assert times.tolist() == [stamp for stamp, _, _ in batch]
        assert numbers.tolist() == [force for _, _, force in batch]


def test_a_batch_has_the_first_numbers_of_the_groups_asked_for():
    joints = {"position": [1.0, 2.0, 3.0], "velocity": [4.0, 5.0, 6.0], "effort": [7.0, 8.0, 9.0]}
    message = serialized(joint_message(["a", "b", "c"], 7, **joints))
    read = BatchReader(JOINTS, {"effort": 2, "position": 1})
    for count in (1, 2):
        assert read(packed([message] * count))[1].tolist() == [[7.0, 8.0, 1.0]] * count
    for part in (b"", message[:-1], b"\0\0" + message[2:], b"\1" + message):
        with pytest.raises(MessageError):
            read(packed([message, part]))
    with pytest.raises(MessageError, match="a message has 6 numbers, expected 7"):
        BatchReader(JOINTS, {"effort": 4, "position": 3})(packed([message]))


@pytest.mark.parametrize("damage", [slice(-1), slice(1, None), slice(3), slice(7)])
def test_messages_that_were_packed_come_back_but_not_from_damaged_bytes(damage):
    whole = packed([b"ab", b"", b"c"])
    assert unpacked(whole) == [b"ab", b"", b"c"] and unpacked(b"") == []
    with pytest.raises(MessageError, match="with their lengths"):
        unpacked(whole[damage])
