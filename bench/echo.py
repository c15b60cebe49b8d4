# SPDX-License-Identifier: Apache-2.0
"""The other end of a hop: a process that sends back what it gets, in one of several ways.

``python -m bench.echo KIND [PORT]``
"""

from __future__ import annotations

import socket
import sys

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from tactile_hand_ros.ros.executor import spin
from tactile_hand_ros.ros.middleware import use_sockets
from tactile_hand_ros.ros.qos import tick_publisher_qos, tick_qos

LEAN, ORDINARY, SOCKET = "lean", "ordinary", "socket"


def connect(node: Node, kind: str, ours: str, theirs: str, answer: bool) -> object:
    """Subscribe to one topic and, if asked to, send each message on to the other.

    Args:
        node: The node.
        kind: LEAN passes bytes, ORDINARY messages.
        ours: Topic to publish.
        theirs: Topic to subscribe to.
        answer: Whether to answer at once.

    Returns:
        The publisher.
    """
    publisher = node.create_publisher(JointState, ours, tick_publisher_qos())
    if answer:
        node.create_subscription(
            JointState, theirs, publisher.publish, tick_qos(), raw=kind == LEAN
        )
    return publisher


def serve_sockets(port: int) -> None:
    """Send datagrams back to where they came from, until the process is ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", port))
        while True:
            data, sender = end.recvfrom(65536)
            end.sendto(data, sender)


def main() -> None:
    """Serve until a signal."""
    kind = sys.argv[1]
    if kind == SOCKET:
        serve_sockets(int(sys.argv[2]))
    use_sockets()
    rclpy.init()
    node = rclpy.create_node("echo")
    connect(node, kind, "pong", "ping", answer=True)
    try:
        spin(node, SingleThreadedExecutor() if kind == ORDINARY else None)
    except (KeyboardInterrupt, ExternalShutdownException):
        return


if __name__ == "__main__":
    main()
