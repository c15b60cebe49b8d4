# SPDX-License-Identifier: Apache-2.0
"""The recorder inside the process of the hand: the same bag, and the hand outlives its writer."""

from __future__ import annotations

import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import psutil
import yaml
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64
from support.graph import PATIENCE, Graph

from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.bag.recover import recover
from tactile_hand_ros.cdr import header_stamp
from tactile_hand_ros.ros.processes import CapturedProcess, wait_until
from tactile_hand_ros.scenario.scenario import NODES, load_scenario

SHARED = {"/diagnostics", "/rosout", "/parameter_events", "/joint_hold"}
"""Topics of which something may be published before a recorder is there, or by many publishers."""


class RecordedGraph(Graph):
    """The composed hand with its recorder, and perhaps a second one in a process of its own."""

    def __init__(self, duration: float, domain: int, folder: Path, *, twice: bool = False) -> None:
        values = {"duration": duration, "plant.autostart": False}
        super().__init__(load_scenario("paper", values), domain, folder, composed=True)
        self.bag, self.other_bag = folder / "inside", folder / "outside"
        self._recorders = 1 + twice

    def _launch(self, executable: str, nodes: Iterable[str], *_: str) -> CapturedProcess:
        if self._recorders == 2:
            flags = ("-r", "__node:=outside", "-p", f"output:={self.other_bag}")
            self._enter("outside", "recorder", "--ros-args", *flags)
        output = ("--ros-args", "-p", f"recorder:output:={self.bag}")
        return super()._launch(executable, nodes, "--record", *output)

    def wait_until_matched(self) -> None:
        """Wait until this test and a recorder outside have met the publishers of the hand."""
        watched = {self.full(topic) for topic in self._types}
        mine = [each for each in self.node.subscriptions if each.topic_name in watched]
        self.wait(lambda: all(each.get_publisher_count() for each in mine), "the publishers")
        topics = self.wait(self.published, "the nodes")
        for topic in topics if self._recorders == 2 else ():
            self.wait(lambda t=topic: self.hears("outside", t[1:]), f"the recorder of {topic}")

    @property
    def writer(self) -> psutil.Process:
        """The process that writes the bag."""
        (child,) = psutil.Process(self.processes["composed"].pid).children()
        return child


def payloads(bag: Path) -> dict[str, list[bytes]]:
    """Return the messages of a bag by topic."""
    found: dict[str, list[bytes]] = {}
    for message in read_messages(bag):
        found.setdefault(message.topic, []).append(message.data)
    return found


def logged_by_nodes(found: dict[str, list[bytes]]) -> set[str]:
    """Return what the nodes of the hand have logged; over DDS the gaps in the bytes are dirty."""
    logged = [deserialize_message(data, Log) for data in found["/rosout"]]
    return {str(each) for each in logged if each.name in NODES}


def announced(bag: Path) -> dict[str, Any]:
    """Return what the metadata of a bag contain for each topic: type, hash and offers."""
    tree = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    topics = [entry["topic_metadata"] for entry in tree["topics_with_message_count"]]
    return {topic["name"]: topic for topic in topics}


def test_it_writes_what_a_recorder_outside_writes(domain: int, tmp_path: Path) -> None:
    """Bytes, types and offers are equal, of this process and of publishers elsewhere."""
    with RecordedGraph(0.2, domain, tmp_path, twice=True) as graph:
        note = graph.node.create_publisher(Float64, "note", 100)
        wait_until(lambda: note.get_subscription_count() == 2, PATIENCE, "both recorders")
        graph.begin(*[target.position for target in graph.scenario.targets])
        for value in range(20):
            note.publish(Float64(data=float(value)))
        graph.finish()
        graph.desire((0.0, 0.0, 0.0), frame="elsewhere")
        graph.wait(lambda: graph.rejected("manipulation_controller", "desired_pose"), "a refusal")
        for name in ("outside", "composed"):
            graph.processes[name].send(signal.SIGINT)
            assert graph.processes[name].wait() == 0, graph.processes[name].stderr
    inside, outside = payloads(graph.bag), payloads(graph.other_bag)
    ticks = graph.scenario.ticks
    assert len(inside["/joint_states"]) == len(inside["/joint_command"]) == ticks
    assert inside["/note"] == [bytes(serialize_message(Float64(data=float(i)))) for i in range(20)]
    assert logged_by_nodes(outside) and logged_by_nodes(outside) <= logged_by_nodes(inside)
    for topic in outside.keys() - SHARED:
        assert len(inside[topic]) == len(outside[topic]), topic
        if len(inside[topic]) >= ticks:  # of others the gaps in the bytes are dirty
            assert inside[topic] == outside[topic], topic
    known, others = announced(graph.bag), announced(graph.other_bag)
    for topic in others.keys() - SHARED:
        assert known[topic] == others[topic]
    assert summarize(graph.bag).custom_data["lost_messages"] == "0"


def test_killed_with_its_hand_it_loses_the_last_ticks_at_most(domain: int, tmp_path: Path) -> None:
    with RecordedGraph(60.0, domain, tmp_path) as graph:
        graph.begin()
        graph.wait(lambda: graph.time > 0.3, "some ticks")
        seen = graph.time
        writer = graph.writer
        graph.kill("composed")
        wait_until(lambda: not writer.is_running(), PATIENCE, "the end of the writer")
    assert not (graph.bag / "metadata.yaml").exists()
    recovered = payloads(recover(graph.bag).target)
    sent = [header_stamp(data) for data in recovered["/joint_states"]]
    stamps = list(dict.fromkeys(sent))  # a slow machine repeats a tick
    tick = graph.scenario.plant.tick
    assert stamps == [tick * i for i in range(len(stamps))]
    in_a_turn = 60  # ticks, far more than fit into the 10 ms until messages are handed on
    assert 1e-9 * stamps[-1] > seen - 1e-9 * in_a_turn * tick
