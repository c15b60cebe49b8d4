# SPDX-License-Identifier: Apache-2.0
"""Nodes that are served in parallel with the test."""

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

from rclpy.node import Node

from tactile_hand_ros.ros.executor import WaitSetExecutor


@contextlib.contextmanager
def spinning(*nodes: Node) -> Iterator[None]:
    """Serve nodes in a thread that is joined at the end; raise its exceptions here."""
    executor = WaitSetExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    failures: list[BaseException] = []
    thread = threading.Thread(target=_spin, args=(executor, failures))
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join()
        if failures:
            raise failures[0]


def _spin(executor: Any, failures: list[BaseException]) -> None:
    try:
        executor.spin()
    except BaseException as error:
        failures.append(error)
