# SPDX-License-Identifier: Apache-2.0
"""Taking part in a ROS graph: namespace, context and node of a command."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.middleware import use_sockets


def full_namespace(given: str, ros_arguments: Sequence[str] = ()) -> str:
    """Return the namespace of the run with a leading slash, ``/`` if there is none.

    Args:
        given: The option, empty if not used.
        ros_arguments: Command line that may remap ``__ns``.

    Raises:
        ConfigurationError: If it is not a ROS namespace.
    """
    remapped = [word.partition("__ns:=")[2] for word in ros_arguments if "__ns:=" in word]
    name = "/" + (given or (remapped[-1] if remapped else "")).strip("/")
    if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", name):
        raise ConfigurationError(
            f"the namespace is '{given or remapped[-1]}', expected names of letters, digits and _ "
            "joined by /, such as /left"
        )
    return name


@contextlib.contextmanager
def ros_context(arguments: Sequence[str] = ()) -> Iterator[Context]:
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
        reason = str(error).split(", at ")[0].splitlines()[0]  # without the place in rcl's sources
        raise ConfigurationError(f"the ROS arguments cannot be used: {reason}") from None
    try:
        yield context
    finally:
        context.try_shutdown()


@contextlib.contextmanager
def graph_node(context: Context, name: str, namespace: str) -> Iterator[Node]:
    """Provide a node of this process, which has no parameter services."""
    node = Node(name, namespace=namespace, context=context, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()
