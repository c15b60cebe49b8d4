# SPDX-License-Identifier: Apache-2.0
"""`/rosout` of nodes that deliver directly: published here, so that their process sees it, too.

ROS publishes log messages below Python, where direct delivery cannot hand them to a recorder of the
same process. So these nodes switch that off and publish the same messages themselves.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.impl import rcutils_logger
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

TOPIC = "/rosout"


def rosout_qos() -> QoSProfile:
    """Return the quality of service of `/rosout` (``rcl_qos_profile_rosout_default``)."""
    return QoSProfile(
        depth=1000,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        lifespan=Duration(seconds=10),
    )


class RosoutLogger(RcutilsLogger):
    """A node's logger that also publishes what it logs."""

    def __init__(self, node: Node) -> None:
        """Publish for a node in the name of its logger."""
        super().__init__(node.get_logger().name)
        self._clock = node.get_clock()
        self._publish: Callable[[Any], None] = node.create_publisher(
            Log, TOPIC, rosout_qos()
        ).publish
        # rclpy looks for the caller outside of the files in this list, which others may add to.
        if __file__ not in rcutils_logger._internal_callers:
            rcutils_logger._internal_callers.append(__file__)

    def log(self, message: str, severity: int, **kwargs: Any) -> bool:
        """Log a message unless a filter forbids it; see the base class."""
        is_logged = bool(super().log(message, severity, **kwargs))
        if is_logged:
            caller = rcutils_logger.CallerId(rcutils_logger._find_caller(inspect.currentframe()))
            self._publish(
                Log(
                    stamp=self._clock.now().to_msg(),
                    level=int(severity),
                    name=self.name,
                    msg=str(message),
                    file=caller.file_path,
                    function=caller.function_name,
                    line=caller.line_number,
                )
            )
        return is_logged
