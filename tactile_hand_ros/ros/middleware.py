# SPDX-License-Identifier: Apache-2.0
"""How the middleware is set up, and contexts of rclpy.

Messages go through sockets alone. Fast DDS would also use shared memory, where a process that is
killed while it sets up its part leaves it half made; the next process that opens it waits for ever,
in native code. Shared memory is a little faster; a hand must not depend on it.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ament_index_python.packages import get_resources

from tactile_hand_ros.config.paths import config_directory
from tactile_hand_ros.errors import ConfigurationError

if TYPE_CHECKING:
    from rclpy.context import Context
    from rclpy.node import Node

_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_ALONE = "ROS_LOCALHOST_ONLY"
_HIGHEST_DOMAIN = 232  # with a higher one, the ports of DDS would not be ports
_MIDDLEWARE, _FAST_DDS = "RMW_IMPLEMENTATION", "rmw_fastrtps"


def socket_settings(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that make Fast DDS use sockets only, in the range that is set.

    Nothing where the user has chosen a profile or another middleware, switched discovery off, or
    there is no configuration. The range ``LOCALHOST`` becomes a profile that means the same: with
    the variable itself, ROS adds shared memory to every profile.

    Args:
        environment: Variables in force.
    """
    if not environment.get(_MIDDLEWARE, _FAST_DDS).startswith(_FAST_DDS):
        return {}
    # The older variable overrules the range, and so must go with it.
    alone = environment.get(_ALONE) == "1"
    reach = "LOCALHOST" if alone else environment.get(_RANGE, "SUBNET")
    try:
        folder = config_directory() / "middleware"
    except ConfigurationError:  # what needs the configuration reports it
        return {}
    chosen = [environment[name] for name in _PROFILES if name in environment]
    # Ours, in force already, unless the user has narrowed the range since.
    if chosen and (Path(chosen[0]).parent != folder or reach != "LOCALHOST"):
        return {}
    if reach == "OFF":
        return {}
    name = "localhost" if reach == "LOCALHOST" else "subnet"
    settings = {_PROFILES[0]: str(folder / f"{name}.xml"), _RANGE: "SUBNET"}
    return {**settings, _ALONE: "0"} if alone else settings


def use_sockets() -> None:
    """Let this process, which has no ROS context yet, and its children use sockets only."""
    os.environ.update(socket_settings(os.environ))


def check_environment(environment: Mapping[str, str]) -> None:
    """Refuse settings with which the nodes could never find each other.

    Call it before rclpy is imported, which ends the process if the middleware is missing.

    Raises:
        ConfigurationError: If the domain does not exist, discovery is off, or the middleware is
            not installed.
    """
    domain = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not domain.isascii() or not domain.isdigit() or int(domain) > _HIGHEST_DOMAIN:
        raise ConfigurationError(
            f"ROS_DOMAIN_ID is '{domain}', expected a whole number from 0 to {_HIGHEST_DOMAIN}"
        )
    if environment.get(_RANGE, "").upper() == "OFF":
        raise ConfigurationError(
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, so that the nodes cannot find each other; set "
            "it to LOCALHOST or SUBNET"
        )
    middleware = environment.get(_MIDDLEWARE, "")
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
def ros_context(arguments: Sequence[str] = (), domain: int | None = None) -> Iterator[Context]:
    """Provide an rclpy context that leaves signals alone.

    Args:
        arguments: Command line with ROS arguments, or nothing.
        domain: ROS domain id, by default that of the environment.

    Raises:
        ConfigurationError: If the ROS arguments cannot be used.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    use_sockets()
    context = Context()
    try:
        rclpy.init(
            context=context,
            args=list(arguments),
            domain_id=domain,
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
    from rclpy.node import Node

    node = Node(name, namespace=namespace, context=context, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()
