# SPDX-License-Identifier: Apache-2.0
"""ROS domains and contexts apart from all others on this machine."""

from __future__ import annotations

import contextlib
import os
import random
import socket
from collections.abc import Iterator, Mapping, Sequence

import rclpy
from rclpy.context import Context

from tactile_hand_ros.ros.middleware import socket_settings

_PORT_BASE = 32768
_DOMAINS = range(60, 102)
"""Lower domains are left to people, higher ones meet ephemeral ports."""


@contextlib.contextmanager
def isolated_domain() -> Iterator[int]:
    """Reserve a ROS domain on this machine and set the environment for it.

    Reserving means binding TCP port 32768 + id, the convention of domain_coordinator. Processes
    that are started inside inherit the domain, and discovery stays on this machine.

    Yields:
        The domain id.
    """
    with _reserve() as domain:
        values = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        with _environment({**values, **socket_settings({**os.environ, **values})}):
            yield domain


@contextlib.contextmanager
def _reserve() -> Iterator[int]:
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as guard:
            try:
                guard.bind(("localhost", _PORT_BASE + domain))
            except OSError:
                continue
            yield domain
            return
    raise RuntimeError(f"all ROS domains from {_DOMAINS[0]} to {_DOMAINS[-1]} are in use")


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def private_context(domain: int, args: Sequence[str] | None = None) -> Iterator[Context]:
    """Provide an rclpy context of its own, shut down at the end."""
    context = Context()
    rclpy.init(context=context, domain_id=domain, args=None if args is None else list(args))
    try:
        yield context
    finally:
        context.try_shutdown()
