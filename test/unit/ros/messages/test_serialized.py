# SPDX-License-Identifier: Apache-2.0
"""Message objects become the bytes that an independent serializer writes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovariance
from rcl_interfaces.msg import Log, Parameter, ParameterEvent, ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState, JoyFeedback, JoyFeedbackArray, PointCloud2, PointField
from std_msgs.msg import Empty, String

from tactile_hand_ros.ros.messages.serialized import serialized

STORE = get_typestore(Stores.ROS2_JAZZY)
PAIRS = [KeyValue(key="a" * i, value="é" * i) for i in range(5)]
VALUES = [ParameterValue(type=7, integer_array_value=[1, 2]), ParameterValue(string_value="x")]
MESSAGES = [
    Empty(),
    String(data="grüß"),
    Log(level=30, name="a", msg="bc", file="def", function="g", line=7),
    DiagnosticArray(status=[DiagnosticStatus(level=b"\1", name="ab", values=PAIRS)]),
    ParameterEvent(node="x", changed_parameters=[Parameter(name="p", value=v) for v in VALUES]),
    JoyFeedbackArray(array=[JoyFeedback(type=1, id=i, intensity=0.5) for i in range(3)]),
    JointState(name=["j"], velocity=[1.0, 2.0]),
    PoseWithCovariance(covariance=np.arange(36.0)),
    PointCloud2(fields=[PointField(name="x", offset=1)], data=bytes(5), is_dense=True),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_the_bytes_are_those_of_another_serializer(message: Any) -> None:
    name = f"{type(message).__module__.split('.')[0]}/msg/{type(message).__name__}"
    dirt = [b"\xff" * 500 for _ in range(100)]
    data = serialized(message)
    del dirt
    theirs = bytes(STORE.serialize_cdr(STORE.deserialize_cdr(data, name), name))
    assert len(data) == -(-len(theirs) // 4) * 4
    assert data == theirs.ljust(len(data), b"\0")
    assert deserialize_message(data, type(message)) == message
    assert len(data) - len(serialize_message(message)) < 4
