# SPDX-License-Identifier: Apache-2.0
"""Upper bound set by message passing: the graph of a run without any computation.

Processes, topics, subscribers and loop are those of a run. But each node only counts the messages
it receives and sends bytes once its inputs of a tick are complete. There are no numbers, no
parameters and no diagnostics.

As a script with ``ROLES READERS TICKS`` it is one process, with roles joined by commas.
"""

from __future__ import annotations

import os
import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import NamedTuple

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node

from bench.processes import CapturedProcess, isolated_domain, start_executable
from tactile_hand_ros import names
from tactile_hand_ros.names import PLANT
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.executor import spin
from tactile_hand_ros.ros.middleware import use_sockets
from tactile_hand_ros.ros.processes import wait_until

_NAMESPACE = "wire"
_BYTES = 200  # size of a message, about the median of a run
_COUNT = struct.Struct("<I")
_WARM = 200  # ticks
_NUDGE = 0.2  # s
_PATIENCE = 60.0  # s


def rate(processes: Sequence[str], ticks: int, *, recorded: bool) -> float:
    """Return the ticks per second of processes, each given by its roles joined by commas."""
    with isolated_domain(), tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        if recorded:
            flags = ("-p", f"output:={folder}/bag", "-p", f"topics:=['/{_NAMESPACE}/.*']")
            stack.enter_context(start_executable("recorder", "--ros-args", *flags))
            wait_until(lambda: list(Path(folder).glob("bag/*.mcap")), _PATIENCE, "the recorder")
        path = {"PYTHONPATH": os.pathsep.join(sys.path)}  # so that it finds `bench`
        members = [
            stack.enter_context(CapturedProcess([sys.executable, __file__, *words], env=path))
            for words in ((roles, str(int(recorded)), str(ticks)) for roles in processes)
        ]
        plant = next(m for m, roles in zip(members, processes, strict=True) if PLANT in roles)
        plant.wait_for_output("ticks/s", _PATIENCE)
        return float(plant.stdout.split()[0])


class Link(NamedTuple):
    """A topic with a message per tick, its publisher and its subscribers."""

    topic: str
    publisher: str
    subscribers: tuple[str, ...] = ()


def each_tick() -> list[Link]:
    """Return the topics of the paper's scenario with a message per tick."""
    acting = (names.REGULATOR, names.OPTIMIZER, names.CONTROLLER)
    links = [
        Link(names.JOINT_STATES, PLANT, (names.REGULATOR, names.CONTROLLER)),
        Link(names.TRUE_CONTACTS, PLANT, (names.SENSOR,)),
        Link(names.TRUE_SLIP, PLANT, (names.SENSOR,)),
        Link(names.OBJECT_POSE, PLANT),
        Link(names.CLOCK, PLANT),
        Link(names.CONTACTS, names.SENSOR, acting),
        Link(names.GRASP_FORCE, names.REGULATOR, (names.CONTROLLER,)),
        Link(names.GRIP_STATE, names.REGULATOR),
        Link(names.GRIP_MARGIN, names.REGULATOR),
        Link(names.JOINT_COMMAND, names.CONTROLLER, (PLANT,)),
        Link(names.AUXILIARY_POSE, names.CONTROLLER),
    ]
    for finger in ("finger_1", "finger_2", "finger_3"):
        links += [
            Link(names.true_wrench(finger), PLANT, (names.SENSOR,)),
            Link(names.wrench(finger), names.SENSOR, (names.REGULATOR,)),
            Link(names.load(finger), names.REGULATOR),
            Link(names.optimal_force(finger), names.OPTIMIZER, (names.CONTROLLER,)),
        ]
    return links


class Role:
    """A node that forwards the messages it receives; the plant starts each tick."""

    def __init__(self, name: str, wiring: Sequence[Link], recorders: int, ticks: int) -> None:
        """Create publishers and subscriptions of a node of the run.

        `recorders` is the number of additional subscribers to all topics.
        """
        self.node = Node(name, namespace=_NAMESPACE)
        sent = [link for link in wiring if link.publisher == name]
        make, depth = self.node.create_publisher, qos.PUBLISHED_DEPTH
        self._publishers = [make(WrenchStamped, link.topic, depth) for link in sent]
        self._readers = [len(link.subscribers) + recorders for link in sent]
        received = [link.topic for link in wiring if name in link.subscribers]
        for topic in received:
            receive, depth = partial(self._receive, topic), qos.TICK_DEPTH
            self.node.create_subscription(WrenchStamped, topic, receive, depth, raw=True)
        self._received, self._first = frozenset(received), received[0]
        self._open: dict[int, set[str]] = {}
        self._tick, self._last, self._began = 0, _WARM + ticks, 0.0
        self._leads = name == PLANT
        if self._leads:
            self.node.create_timer(_NUDGE, self._nudge)

    def _send(self, tick: int) -> None:
        data = b"\x00\x01\x00\x00" + _COUNT.pack(tick) + bytes(_BYTES - 8)
        for publisher in self._publishers:
            publisher.publish(data)

    def _nudge(self) -> None:
        """Send the current tick again if all its subscribers are matched."""
        present = [publisher.get_subscription_count() for publisher in self._publishers]
        if self._tick < self._last and present == self._readers:
            self._send(self._tick)

    def _receive(self, topic: str, data: bytes) -> None:
        (tick,) = _COUNT.unpack_from(data, 4)
        if tick < self._tick:
            if tick == self._tick - 1 and topic == self._first and not self._leads:
                self._send(tick)  # another node missed it
            return
        received = self._open.setdefault(tick, set())
        received.add(topic)
        if received == self._received:
            self._open.clear()
            self._tick = tick + 1
            self._send(tick + self._leads)
            self._time()

    def _time(self) -> None:
        if not self._leads:
            return
        if self._tick == _WARM:
            self._began = time.perf_counter()
        elif self._tick == self._last:
            passed = time.perf_counter() - self._began
            print(f"{(self._last - _WARM) / passed:.1f} ticks/s", flush=True)


def main() -> None:
    """Serve the roles until a signal."""
    roles, recorders, ticks = sys.argv[1].split(","), int(sys.argv[2]), int(sys.argv[3])
    wiring = each_tick()
    use_sockets()
    rclpy.init()
    try:
        spin([Role(role, wiring, recorders, ticks).node for role in roles])
    except KeyboardInterrupt:
        return


if __name__ == "__main__":
    main()
