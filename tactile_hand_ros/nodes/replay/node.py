# SPDX-License-Identifier: Apache-2.0
"""A replay as a participant of the graph: context, node and the thread that serves it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tactile_hand_ros.nodes.replay.options import ReplayOptions
from tactile_hand_ros.nodes.replay.replay import Replay
from tactile_hand_ros.ros.middleware import use_sockets

NODE = "replay"


@contextmanager
def replaying(bag: Path, options: ReplayOptions) -> Iterator[Replay]:
    """Open a bag for replay by a node of its own; signals are left to the caller.

    Raises:
        BagError: If the bag cannot be replayed.
    """
    use_sockets()
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(NODE, context=context, start_parameter_services=False, enable_rosout=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = threading.Thread(target=_spin, args=(executor,), daemon=True)
    try:
        player = Replay(node, bag, options)
        thread.start()
        try:
            yield player
        finally:
            executor.shutdown()
            thread.join()
            player.close()
    finally:
        node.destroy_node()
        context.try_shutdown()


def _spin(executor: SingleThreadedExecutor) -> None:
    try:
        executor.spin()
    except (ExternalShutdownException, ShutdownException):
        return
