# SPDX-License-Identifier: Apache-2.0
"""Middleware settings and rclpy contexts.

Messages use sockets only. Fast DDS would also use shared memory. A process that is killed while it
sets up its segment leaves it half initialized, and the next process that opens it waits forever in
native code. Shared memory is slightly faster, but a hand must not depend on it.
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
_HIGHEST_DOMAIN = 232  # above it, the DDS port numbers are invalid
_MIDDLEWARE, _FAST_DDS = "RMW_IMPLEMENTATION", "rmw_fastrtps"


def socket_settings(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that make Fast DDS use sockets only, within the discovery range.

    The result is empty if the user has chosen a profile or another middleware or disabled
    discovery, or if the configuration is missing. The range ``LOCALHOST``, as which ROS takes
    unknown ones too, becomes an equivalent profile: with that variable ROS adds shared memory to
    every profile.
    """
    if not environment.get(_MIDDLEWARE, _FAST_DDS).startswith(_FAST_DDS):
        return {}
    # The older variable overrides the range, so it must be reset too.
    alone = environment.get(_ALONE) == "1"
    reach = "LOCALHOST" if alone else environment.get(_RANGE) or "SUBNET"
    leaves_machine = reach in ("SUBNET", "SYSTEM_DEFAULT")
    try:
        folder = config_directory() / "middleware"
    except ConfigurationError:  # reported where the configuration is needed
        return {}
    chosen = [environment[name] for name in _PROFILES if name in environment]
    # A profile of ours stays in force unless the user has narrowed the range since.
    if reach == "OFF" or (chosen and (Path(chosen[0]).parent != folder or leaves_machine)):
        return {}
    name = "subnet" if leaves_machine else "localhost"
    settings = {_PROFILES[0]: str(folder / f"{name}.xml"), _RANGE: "SUBNET"}
    return {**settings, _ALONE: "0"} if alone else settings


def use_sockets() -> None:
    """Make this process and its children use sockets only; call it before ROS is initialized."""
    os.environ.update(socket_settings(os.environ))


def check_environment(environment: Mapping[str, str]) -> None:
    """Reject settings that keep the nodes from discovering each other.

    Call it before importing rclpy, which exits the process if the middleware is missing.

    Raises:
        ConfigurationError: If the domain is invalid, discovery is off, or the middleware is not
            installed.
    """
    domain = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not domain.isascii() or not domain.isdigit() or int(domain) > _HIGHEST_DOMAIN:
        raise ConfigurationError(
            f"ROS_DOMAIN_ID is '{domain}', expected a whole number from 0 to {_HIGHEST_DOMAIN}"
        )
    if environment.get(_RANGE, "").upper() == "OFF":
        raise ConfigurationError(
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, so the nodes cannot find each other; set it to "
            "LOCALHOST or SUBNET"
        )
    middleware = environment.get(_MIDDLEWARE, "")
    installed = sorted(set(get_resources("rmw_typesupport")) - {"rmw_implementation"})
    if middleware and installed and middleware not in installed:
        raise ConfigurationError(
            f"RMW_IMPLEMENTATION is '{middleware}', which is not installed here; expected "
            f"{' or '.join(installed)}, or nothing"
        )


def full_namespace(given: str, ros_arguments: Sequence[str] = ()) -> str:
    """Return the run's namespace with a leading slash, from the option or a remapping of ``__ns``.

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
def arguments_checked() -> Iterator[None]:
    """Turn the errors of rcl for bad ROS arguments into ConfigurationError."""
    try:
        yield
    except RuntimeError as error:
        reason = str(error).split(", at ")[0].removeprefix("failed to initialize rcl: ")
        raise ConfigurationError(f"the ROS arguments cannot be used: {reason}.") from None


@contextlib.contextmanager
def ros_context(arguments: Sequence[str] = (), domain: int | None = None) -> Iterator[Context]:
    """Provide an rclpy context without signal handlers, by default in the environment's domain.

    Raises:
        ConfigurationError: If the ROS arguments are invalid.
    """
    from rclpy.context import Context

    use_sockets()
    context = Context()
    with arguments_checked():
        quiet = "--ros-args", "--disable-external-lib-logs"  # no log file, also without a HOME
        context.init([*arguments, *quiet], domain_id=domain)  # without signal handlers
    try:
        yield context
    finally:
        context.try_shutdown()


@contextlib.contextmanager
def graph_node(context: Context, name: str, namespace: str) -> Iterator[Node]:
    """Provide a node without parameter services."""
    from rclpy.node import Node

    node = Node(name, namespace=namespace, context=context, start_parameter_services=False)
    try:
        yield node
    finally:
        node.destroy_node()
