# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process of its own, over real DDS: a kill costs the last moment at most."""

import contextlib
import signal
import time

import psutil
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64

from bench.processes import start_executable
from tactile_hand_ros.bag.reader import read_messages
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.ros.processes import wait_until

BOUND = 2.0  # s


def test_killed_at_any_moment_it_loses_the_last_moment_at_most(context: Context, tmp_path):
    """What is recovered has no gap; the bound is 0.2 s, here with room for noise.

    The chunks never fill: what is on the disk is there because its time had come.
    """
    node, sent = Node("talker", context=context), list[float]()
    publisher = node.create_publisher(Float64, "number", QoSProfile(depth=1000))
    bags = {life: tmp_path / str(life) for life in (0.0, 0.3, BOUND + 0.5)}
    with contextlib.ExitStack() as stack:
        stack.callback(node.destroy_node)
        recorders = {
            life: stack.enter_context(
                start_executable("recorder", "--ros-args", "-p", f"output:={bag}")
            )
            for life, bag in bags.items()
        }
        wait_until(lambda: publisher.get_subscription_count() == len(bags), 60.0)
        for life, recorder in recorders.items():
            writers = psutil.Process(recorder.pid).children()
            while not sent or time.monotonic() < sent[0] + life:
                publisher.publish(Float64(data=float(len(sent))))
                sent.append(time.monotonic())
                signal.sigtimedwait([], 0.002)
            recorder.send(signal.SIGKILL)
            killed = time.monotonic()
            assert recorder.wait() == -signal.SIGKILL
            psutil.wait_procs(writers, 30.0)
            saved = sum(at < killed - BOUND for at in sent)
            with contextlib.nullcontext() if saved else contextlib.suppress(BagError):
                recovered = read_messages(recover(bags[life]).target, ["/number"])
                numbers = [message.message.data for message in recovered]
                assert numbers == [float(i) for i in range(len(numbers))] and len(numbers) >= saved
