# SPDX-License-Identifier: Apache-2.0
"""How long a message takes from one process to another, by our loop, rclpy's, and a bare socket."""

from __future__ import annotations

import socket
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from rclpy.timer import Timer
from sensor_msgs.msg import JointState

from bench.echo import LEAN, ORDINARY, SOCKET, connect
from bench.results import Result
from bench.workload import Workload
from tactile_hand_ros.ros.domains import isolated_domain, private_context
from tactile_hand_ros.ros.executor import make_executor
from tactile_hand_ros.ros.processes import CapturedProcess, wait_until
from tactile_hand_ros.ros.qos import tick_qos

HOPS = 2000
_WARM = 200
_PATIENCE = 60.0  # s
_NUDGE = 0.2  # s
_ECHO = [sys.executable, str(Path(__file__).with_name("echo.py"))]


def measure_hops(work: Workload) -> list[Result]:
    """Send joint states to another process and back, half of the way is a hop."""
    count = min(HOPS, 2 * len(work.record))
    names = [f"q{i}" for i in range(work.record.theta.shape[1])]
    values = [0.0] * len(names)
    message = JointState(name=names, position=values, velocity=values, effort=values)
    floor = Result.of("hop, bare UDP socket", "us", _socket_hops(count, message))
    lean = Result.of("hop, our loop, bytes", "us", _ros_hops(LEAN, count, message))
    plain = Result.of("hop, rclpy's executor", "us", _ros_hops(ORDINARY, count, message))
    return [floor, lean.against(floor), plain.against(lean)]


def _socket_hops(count: int, message: JointState) -> NDArray[np.float64]:
    data = serialize_message(message)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end,
    ):
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        end.settimeout(0.1)

        def turn() -> bool:
            end.sendto(data, ("127.0.0.1", port))
            try:
                return bool(end.recv(65536))
            except (TimeoutError, ConnectionError):
                return False

        with CapturedProcess([*_ECHO, SOCKET, str(port)]):
            wait_until(turn, _PATIENCE, "the echo")
            return _half_turns(turn, count)


def _half_turns(turn: object, count: int) -> NDArray[np.float64]:
    """Return the time of half a turn in us, after some turns to warm up."""
    times = np.empty(count + _WARM)
    for i in range(len(times)):
        began = time.perf_counter()
        turn()  # type: ignore[operator]
        times[i] = 0.5e6 * (time.perf_counter() - began)
    return times[_WARM:]


def _ros_hops(kind: str, count: int, message: JointState) -> NDArray[np.float64]:
    with isolated_domain() as domain, private_context(domain) as context:
        node = rclpy.create_node("ping", context=context)
        executor = (
            SingleThreadedExecutor(context=context) if kind == ORDINARY else make_executor(context)
        )
        publisher = connect(node, kind, "ping", "pong", answer=False)
        sent = serialize_message(message) if kind == LEAN else message
        times: list[float] = []
        began = 0.0

        def send() -> None:
            nonlocal began
            began = time.perf_counter()
            publisher.publish(sent)  # type: ignore[attr-defined]

        def receive(_: object) -> None:
            times.append(0.5e6 * (time.perf_counter() - began))
            if len(times) < count + _WARM:
                send()
            else:
                executor.shutdown(timeout_sec=0)

        heard = node.create_subscription(JointState, "pong", receive, tick_qos(), raw=kind == LEAN)
        with CapturedProcess([*_ECHO, kind]):
            wait_until(
                lambda: (
                    publisher.get_subscription_count()  # type: ignore[attr-defined]
                    and heard.get_publisher_count()
                ),
                _PATIENCE,
                "the echo",
            )
            # The echo may not have met us yet, and what it misses is gone: ask again.
            nudge: Timer = node.create_timer(_NUDGE, lambda: nudge.cancel() if times else send())
            executor.add_node(node)
            executor.spin()
        node.destroy_node()
    return np.array(times[_WARM:])
