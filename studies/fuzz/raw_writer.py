# SPDX-License-Identifier: Apache-2.0
"""Any bytes on any topic of the middleware, requests of services included.

rclpy publishes bytes on topics of messages only. A request travels on a topic too, whose name no
ROS publisher may have, so this calls the middleware's own C functions. For hostile tests: nothing
that runs a hand needs it.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, byref, c_bool, c_char_p, c_int, c_size_t, c_uint64, c_void_p
from typing import Any

from rclpy.node import Node

from tactile_hand_ros.errors import TactileHandError

_RELIABLE, _VOLATILE, _KEEP_LAST, _AUTOMATIC = 1, 2, 1, 1
_DEPTH = 1000


class RawWriterError(TactileHandError):
    """The middleware refused a topic or bytes."""


class _Time(ctypes.Structure):
    _fields_ = [("seconds", c_uint64), ("nanoseconds", c_uint64)]


class _Qos(ctypes.Structure):
    """rmw_qos_profile_t."""

    _fields_ = [
        ("history", c_int),
        ("depth", c_size_t),
        ("reliability", c_int),
        ("durability", c_int),
        ("deadline", _Time),
        ("lifespan", _Time),
        ("liveliness", c_int),
        ("lease", _Time),
        ("without_ros_names", c_bool),
    ]


class _Options(ctypes.Structure):
    """rmw_publisher_options_t."""

    _fields_ = [("payload", c_void_p), ("unique", c_int)]


class _Bytes(ctypes.Structure):
    """rmw_serialized_message_t with its allocator, which a message that is sent never uses."""

    _fields_ = [
        ("buffer", c_void_p),
        ("length", c_size_t),
        ("capacity", c_size_t),
        ("allocator", c_void_p * 5),
    ]


def _libraries() -> tuple[Any, Any]:
    rcl, rmw = ctypes.CDLL("librcl.so"), ctypes.CDLL("librmw_fastrtps_cpp.so")
    rcl.rcl_node_get_rmw_handle.restype = c_void_p
    rcl.rcl_node_get_rmw_handle.argtypes = [c_void_p]
    create = rmw.rmw_create_publisher
    create.restype = c_void_p
    create.argtypes = [c_void_p, c_void_p, c_char_p, POINTER(_Qos), POINTER(_Options)]
    rmw.rmw_publish_serialized_message.argtypes = [c_void_p, POINTER(_Bytes), c_void_p]
    rmw.rmw_publisher_count_matched_subscriptions.argtypes = [c_void_p, POINTER(c_size_t)]
    rmw.rmw_destroy_publisher.argtypes = [c_void_p, c_void_p]
    return rcl, rmw


def _type_support(kind: Any) -> int:
    kind.__class__.__import_type_support__()
    capsule = kind.__class__._TYPE_SUPPORT
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = c_char_p, [ctypes.py_object]
    api.PyCapsule_GetPointer.restype = c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, c_char_p]
    return int(api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule)))


def request_topic(service: str) -> str:
    """Return the topic of the requests of a service with this full name."""
    return f"rq{service}Request"


class RawWriter:
    """Writes bytes, as they are, to a topic of the middleware."""

    def __init__(self, node: Node, kind: Any, topic: str) -> None:
        """Create the writer.

        Args:
            node: Node of which it is a part.
            kind: Message class, or the class of the request of a service.
            topic: Name in the middleware, such as `request_topic` gives.

        Raises:
            RawWriterError: If the middleware refuses it.
        """
        rcl, self._rmw = _libraries()
        self._node = rcl.rcl_node_get_rmw_handle(node.handle.pointer)
        never = _Time()
        qos = _Qos(_KEEP_LAST, _DEPTH, _RELIABLE, _VOLATILE, never, never, _AUTOMATIC, never, True)
        self._writer = self._rmw.rmw_create_publisher(
            self._node, _type_support(kind), topic.encode(), byref(qos), byref(_Options())
        )
        if not self._writer:
            raise RawWriterError(f"the middleware does not let us write to '{topic}'")

    @property
    def readers(self) -> int:
        """How many readers have been met."""
        count = c_size_t()
        self._rmw.rmw_publisher_count_matched_subscriptions(self._writer, byref(count))
        return count.value

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            RawWriterError: If the middleware refuses them.
        """
        buffer = ctypes.create_string_buffer(data, len(data))
        message = _Bytes(ctypes.cast(buffer, c_void_p), len(data), len(data))
        if self._rmw.rmw_publish_serialized_message(self._writer, byref(message), None):
            raise RawWriterError(f"the middleware does not send these {len(data)} bytes")

    def close(self) -> None:
        """Destroy the writer, before its node."""
        self._rmw.rmw_destroy_publisher(self._node, self._writer)
