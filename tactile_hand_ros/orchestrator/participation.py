# SPDX-License-Identifier: Apache-2.0
"""The orchestrator's own part in the ROS graph: its context and its node."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.names import ORCHESTRATOR
from tactile_hand_ros.ros.middleware import use_sockets

_HIGHEST_DOMAIN = 232  # with a higher one, the ports of DDS would not be ports


def check_environment(environment: Mapping[str, str]) -> None:
    """Refuse settings with which the nodes could never meet.

    Raises:
        ConfigurationError: If the domain does not exist or discovery is off.
    """
    domain = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not domain.isascii() or not domain.isdigit() or int(domain) > _HIGHEST_DOMAIN:
        raise ConfigurationError(
            f"ROS_DOMAIN_ID is '{domain}', expected a whole number from 0 to {_HIGHEST_DOMAIN}"
        )
    if environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "OFF":
        raise ConfigurationError(
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, so that the nodes cannot find each other; set "
            "it to LOCALHOST or SUBNET"
        )


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
