# SPDX-License-Identifier: Apache-2.0
"""Messages built field by field with ROS, independent of the package's codecs."""

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, WrenchStamped
from numpy.typing import ArrayLike
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from bench.written import TickMessages
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.names import PALM_FRAME
from tactile_hand_ros.rotations import quaternion_from_rotation

STORE = get_typestore(Stores.ROS2_JAZZY)
STRING = "std_msgs/msg/String"
STRING_HASH = STORE.hash_rihs01(STRING)


def payload(text: str) -> bytes:
    """Return the bytes of a String."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def header(stamp_ns: int, frame: str = PALM_FRAME) -> Header:
    """Return a header with a timestamp [ns] and a frame."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame)


def stamp_to_ns(stamp: Time) -> int:
    """Return a message timestamp in nanoseconds."""
    return stamp.sec * 10**9 + stamp.nanosec


def pose(position: ArrayLike, quaternion: ArrayLike) -> Pose:
    """Return a pose from a position and a quaternion in the order x, y, z, w."""
    point = Point(**dict(zip("xyz", np.asarray(position, float).tolist(), strict=True)))
    turn = Quaternion(**dict(zip("xyzw", np.asarray(quaternion, float).tolist(), strict=True)))
    return Pose(position=point, orientation=turn)


def pose_message(
    position: ArrayLike, rotation: ArrayLike, stamp_ns: int, *, frame: str = PALM_FRAME
) -> PoseStamped:
    """Return a pose with a rotation matrix or a quaternion."""
    turn = np.asarray(rotation)
    quaternion = quaternion_from_rotation(turn) if turn.ndim == 2 else turn
    return PoseStamped(header=header(stamp_ns, frame), pose=pose(position, quaternion))


def contacts_message(positions: ArrayLike, quaternions: ArrayLike, stamp_ns: int) -> PoseArray:
    """Return contact frames in the palm frame."""
    rows = zip(np.asarray(positions), np.asarray(quaternions), strict=True)
    return PoseArray(header=header(stamp_ns), poses=[pose(*row) for row in rows])


def force_message(force: ArrayLike, stamp_ns: int, frame: str = PALM_FRAME) -> WrenchStamped:
    """Return a force without torque."""
    message = WrenchStamped(header=header(stamp_ns, frame))
    vector = message.wrench.force
    vector.x, vector.y, vector.z = np.asarray(force, float).tolist()
    return message


def joint_message(names: list[str], stamp_ns: int, **fields: ArrayLike) -> JointState:
    """Return joint states with the given fields; the others stay empty."""
    lists = {name: np.asarray(values, float).tolist() for name, values in fields.items()}
    return JointState(header=header(stamp_ns, ""), name=names, **lists)


def type_name(message: object) -> str:
    """Return the type of a message as bags and topics name it."""
    kind = type(message)
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def serialized(message: object) -> bytes:
    """Return the bytes of a message without what ROS leaves behind the end of empty arrays."""
    data, definition = serialize_message(message), STORE.get_msgdef(type_name(message))
    _, end = definition.deserialize_cdr_le(data[4:], 0, definition.cls, STORE)
    return bytes(data[: 4 + end])


def encoded(run: Record) -> dict[str, list[bytes]]:
    """Return the bytes of every topic of the ticks of an in-process run."""
    found: dict[str, list[bytes]] = {}
    messages = TickMessages(run)
    for row in range(len(run)):
        for topic, _, data in messages.of(row):
            found.setdefault(f"/{topic}", []).append(data)
    return found
