# SPDX-License-Identifier: Apache-2.0
"""What recording costs, and how fast a bag is recomputed.

``python -m bench.recording TOPICS RATE COUNT`` is the process that is recorded.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import rclpy
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from bench.results import Goal, Result
from bench.workload import Workload
from tactile_hand_ros.bag.reader import summarize
from tactile_hand_ros.ros.domains import isolated_domain
from tactile_hand_ros.ros.middleware import use_sockets
from tactile_hand_ros.ros.processes import CapturedProcess, start_executable, wait_until
from tactile_hand_ros.ros.qos import tick_publisher_qos
from tactile_hand_ros.verify.recompute import ShadowLoop
from tactile_hand_ros.verify.recorded_inputs import Effect, Inputs, configured

TOPICS = 12
RATE = 5000.0  # messages/s on all topics
_JOINTS = 9
_TIMEOUT = 60.0  # s


def measure_recorder(work: Workload, seconds: float = 6.0) -> list[Result]:
    """Record 5,000 messages/s on 12 topics from another process; count losses and CPU time."""
    shares, lost, rates = [], [], []
    for _ in range(work.repeats):
        share, missing, rate = _record(round(seconds * RATE / TOPICS))
        shares.append(100.0 * share)
        lost.append(float(missing))
        rates.append(rate)
    return [
        Result.of("recorder, messages offered", "1/s", rates),
        Result.of("recorder, share of a core", "%", shares, Goal("median", at_most=25.0)),
        Result.of("recorder, messages lost", "", lost, Goal("largest", at_most=0.0)),
    ]


def measure_recompute(work: Workload) -> list[Result]:
    """Feed the sensor topics of a run through the controllers."""
    record = work.record
    felt = np.isfinite(record.forces).all(axis=(1, 2))
    poses = [Effect(target.stamp, target.target()) for target in work.scenario.targets]
    configurations = configured(work.scenario)
    inputs = Inputs(record, list(work.grasps), np.asarray(felt), configurations, poses)
    speeds = []
    for _ in range(work.repeats):
        began = time.perf_counter()
        ShadowLoop(inputs).run()
        speeds.append(record.times[-1] / (time.perf_counter() - began))
    goal = Goal("median", at_least=5.0)
    return [Result.of("recompute, times real time", "x", speeds, goal)]


def _record(count: int) -> tuple[float, int, float]:
    """Record `count` messages a topic; return CPU share, messages lost and messages per second."""
    arguments = [str(TOPICS), str(RATE), str(count)]
    with isolated_domain(), tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        flags = ("-p", f"output:={bag}", "-p", "topics:=['/bench/.*']")
        with start_executable("recorder", "--ros-args", *flags) as recorder:
            wait_until(lambda: list(bag.glob("*.mcap")), _TIMEOUT, "the recorder")
            command = [sys.executable, __file__, *arguments]
            with CapturedProcess(command) as talker:
                talker.wait_for_output("begin", _TIMEOUT)
                process = psutil.Process(recorder.pid)
                before, began = sum(process.cpu_times()[:2]), time.monotonic()
                talker.wait_for_output("end", _TIMEOUT)
                used, passed = sum(process.cpu_times()[:2]) - before, time.monotonic() - began
            recorder.send(signal.SIGINT)
            recorder.wait()
        found = summarize(bag).message_count
    return used / passed, TOPICS * count - found, TOPICS * count / passed


def talk(topics: int, rate: float, count: int) -> None:
    """Publish joint states on some topics at a rate for all of them, once there is a subscriber."""
    use_sockets()
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node("talker", context=context)
    publishers = [
        node.create_publisher(JointState, f"/bench/t{i}", tick_publisher_qos())
        for i in range(topics)
    ]
    wait_until(lambda: all(p.get_subscription_count() for p in publishers), _TIMEOUT)
    names = [f"joint_{i}" for i in range(_JOINTS)]
    data = serialize_message(JointState(name=names, position=np.zeros(_JOINTS).tolist()))
    print("begin", flush=True)
    begin = time.monotonic()
    for i in range(count):
        for publisher in publishers:
            publisher.publish(data)
        ahead = begin + (i + 1) * topics / rate - time.monotonic()
        signal.sigtimedwait([], max(0.0, ahead))
    print("end", flush=True)
    signal.sigtimedwait([], 5.0)  # for what is asked for again, unless ended before
    node.destroy_node()
    context.try_shutdown()


if __name__ == "__main__":
    talk(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
