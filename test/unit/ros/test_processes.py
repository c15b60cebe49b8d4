# SPDX-License-Identifier: Apache-2.0
"""Isolated domains, waiting, and processes that leave nothing behind."""

import os
import signal
import sys
from typing import Any

import psutil
import pytest
import rclpy
from std_msgs.msg import Float64

from bench.processes import CapturedProcess, isolated_domain
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.middleware import ros_context
from tactile_hand_ros.ros.processes import end_together, executable_path, wait_until


@pytest.mark.parametrize("prefix", [None, "/nowhere"])
def test_a_package_that_is_not_there_is_named(monkeypatch, prefix):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    if prefix is not None:
        monkeypatch.setenv("AMENT_PREFIX_PATH", prefix)
    with pytest.raises(TactileHandError, match=f"AMENT_PREFIX_PATH='{prefix or ''}'"):
        executable_path("plant")


def test_an_executable_that_is_not_there_is_named():
    said = "no executable .*lib/tactile_hand_ros/no_such_node;"
    with pytest.raises(TactileHandError, match=said):
        executable_path("no_such_node")


def test_nodes_of_two_domains_do_not_meet_and_listen_on_the_loopback_address_only(context):
    with isolated_domain() as domain, ros_context(domain=domain) as elsewhere:
        contexts = {"a": context, "b": context, "c": elsewhere}
        nodes = [rclpy.create_node(name, context=contexts[name]) for name in contexts]
        publisher = nodes[0].create_publisher(Float64, "x", 10)
        for node in nodes[1:]:
            node.create_subscription(Float64, "x", print, 10)
        wait_until(lambda: publisher.get_subscription_count() > 0)
        assert publisher.get_subscription_count() == 1
        connections = psutil.Process().net_connections(kind="udp")
        assert {each.laddr.ip for each in connections if each.laddr.port > 0} == {"127.0.0.1"}
        for node in nodes:
            node.destroy_node()


def test_waiting_in_vain_says_for_what():
    with pytest.raises(TimeoutError, match="timed out after 0.05 s waiting for the moon"):
        wait_until(lambda: False, 0.05, "the moon")
    assert wait_until(lambda: 3) == 3


def test_a_stopped_process_ends_as_cleanly_as_any_other():
    program = (
        "import signal, sys\n"
        "signal.signal(signal.SIGINT, lambda *_: sys.exit(0))\n"
        "print('ready', flush=True)\n"
        "signal.pause()\n"
    )
    with CapturedProcess([sys.executable, "-c", program]) as process:
        process.wait_for_output("ready", 10.0)
        process.send(signal.SIGSTOP)
        wait_until(lambda: psutil.Process(process.pid).status() == psutil.STATUS_STOPPED)
        end_together([process])
        assert process.returncode == 0


def test_all_that_a_process_has_started_ends_with_it_even_if_it_ignores_signals():
    """A group whose leader was reaped gets no signal: its number may have been reused."""
    program = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "child = os.fork()\n"
        "if not child: signal.pause()\n"
        "print(child, flush=True)\n"
        "sys.stdin.read()\n"
    )
    with CapturedProcess([sys.executable, "-c", program]) as process:
        assert process.wait() == 0
        pid = int(process.stdout)
        wait_until(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == "zombie")
        sent: list[Any] = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "killpg", lambda *_: sent.append(_))
            process.send_to_group(signal.SIGTERM)
            end_together([process])
        assert sent == []
