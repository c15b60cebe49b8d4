# SPDX-License-Identifier: Apache-2.0
"""Tick messages in batches: all of them, in order, and only for a subscriber."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import MultiArrayDimension, UInt8MultiArray
from support.nodes import Process

from tactile_hand_ros import names
from tactile_hand_ros.errors import MessageError
from tactile_hand_ros.nodes.plant.node import PlantNode
from tactile_hand_ros.ros.messages import JointCodec
from tactile_hand_ros.ros.relay import unpack_batch


def test_all_messages_of_a_node_arrive_in_batches_while_somebody_listens(here: Process) -> None:
    node = here.make(PlantNode, composed=False, autostart=False)
    (joints,) = (p for p in node.tick_publishers if p.kind is JointState and "joint" in p.topic)
    angles = np.arange(9.0)
    joints.publish(1, angles, angles, angles)
    assert not joints.wanted
    batches = here.receive(UInt8MultiArray, names.ticks_of(names.PLANT))
    here.wait(lambda: joints.wanted, "the relay to listen")
    expected, names_of_joints = [], node._run.plant.hand.joint_names
    encode = JointCodec(names_of_joints, ("position", "velocity", "effort")).encode
    for stamp in range(2, 40):
        angles = angles + 0.5
        joints.publish(stamp, angles, angles, angles)
        expected.append(encode(stamp, angles, angles, angles))
    here.messages(names.ticks_of(names.PLANT), 1)
    found: list[bytes] = []

    def all_came() -> bool:
        here.messages(names.ticks_of(names.PLANT), 0)
        found[:] = [m for b in batches for m in unpack_batch(b)[names.JOINT_STATES]]
        return len(found) >= len(expected)

    here.wait(all_came, "all messages")
    assert found == expected
    here.user.destroy_subscription(here._received.pop(names.ticks_of(names.PLANT))[0])
    here.wait(lambda: not joints.wanted, "the relay to stop")


@pytest.mark.parametrize("change", [-1, 1, 10**6])
def test_a_batch_whose_sizes_are_wrong_is_refused(change: int) -> None:
    message = UInt8MultiArray(data=b"\x02\x00\x00\x00ab\x01\x00\x00\x00c")
    message.layout.dim = [_part("topic", 11)]
    assert unpack_batch(message) == {"topic": [b"ab", b"c"]}
    message.layout.dim = [_part("topic", 11 + change)]
    with pytest.raises(MessageError, match="topic"):
        unpack_batch(message)


def _part(label: str, size: int) -> MultiArrayDimension:
    return MultiArrayDimension(label=label, size=size)
