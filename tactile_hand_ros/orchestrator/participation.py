# SPDX-License-Identifier: Apache-2.0
"""Taking part in a ROS graph: environment, namespace, context and node of a command."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence

import rclpy
from ament_index_python.packages import get_resources
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros.middleware import use_sockets

_HIGHEST_DOMAIN = 232  # with a higher one, the ports of DDS would not be ports


def check_environment(environment: Mapping[str, str]) -> None:
    """Refuse settings with which the nodes could never find each other.

    Raises:
        ConfigurationError: If the domain does not exist, discovery is off, or the middleware is
            not installed.
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
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    installed = sorted(set(get_resources("rmw_typesupport")) - {"rmw_implementation"})
    if middleware and installed and middleware not in installed:
        raise ConfigurationError(
            f"RMW_IMPLEMENTATION is '{middleware}', which is not installed here; expected "
            f"{' or '.join(installed)}, or nothing"
        )


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
