# SPDX-License-Identifier: Apache-2.0
"""Nodes that are served in parallel with the test."""

import contextlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from rclpy.node import Node

from tactile_hand_ros.ros.executor import WaitSetExecutor


@contextlib.contextmanager
def spinning(*nodes: Node) -> Iterator[None]:
    """Serve nodes in a thread that is joined at the end; raise its exceptions here."""
    executor = WaitSetExecutor(context=nodes[0].context)
    for node in nodes:
        executor.add_node(node)
    with ThreadPoolExecutor(1) as pool:
        served = pool.submit(executor.spin)
        try:
            yield
        finally:
            executor.shutdown()
            served.result()
