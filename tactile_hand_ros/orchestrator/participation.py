# SPDX-License-Identifier: Apache-2.0
"""The orchestrator's own part in the ROS graph: its context and its node."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.names import ORCHESTRATOR
from tactile_hand_ros.ros.middleware import use_sockets


@contextlib.contextmanager
def ros_context(arguments: Sequence[str]) -> Iterator[Context]:
    """Provide an rclpy context that leaves signals alone.

    Args:
        arguments: Command line with ROS arguments, or nothing.

    Raises:
        ConfigurationError: If the ROS arguments cannot be used.
    """
    use_sockets()
    context = Context()
    try:
        rclpy.init(
            context=context,
            args=list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:
        raise ConfigurationError(f"the ROS arguments cannot be used: {first_line(error)}") from None
    try:
        yield context
    finally:
        context.try_shutdown()


@contextlib.contextmanager
def graph_node(context: Context, namespace: str) -> Iterator[Node]:
    """Provide a node of this process in the namespace of the run."""
    node = Node(ORCHESTRATOR, namespace=namespace, context=context, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()


def first_line(error: Exception) -> str:
    """Return what an error of rcl says, without the place in its sources."""
    return str(error).split(", at ")[0].splitlines()[0]
