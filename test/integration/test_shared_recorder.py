# SPDX-License-Identifier: Apache-2.0
"""The recorder inside the process of the hand: the same bag."""

from __future__ import annotations

import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64
from support.graph import PATIENCE, Graph

from bench.processes import CapturedProcess
from tactile_hand_ros.bag.reader import read_messages, summarize
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.scenario.scenario import NODES, load_scenario

SHARED = {"/diagnostics", "/rosout", "/parameter_events", "/joint_hold"}
"""Topics of which something may be published before a recorder is there, or by many publishers."""


class RecordedGraph(Graph):
    """The composed hand with its recorder, and a second one in a process of its own."""

    def __init__(self, duration: float, domain: int, folder: Path) -> None:
        values = {"duration": duration, "plant.autostart": False}
        super().__init__(load_scenario("paper", values), domain, folder, composed=True)
        self.bag, self.other_bag = folder / "inside", folder / "outside"

    def _launch(self, executable: str, nodes: Iterable[str], *_: str) -> CapturedProcess:
        flags = ("-r", "__node:=outside", "-p", f"output:={self.other_bag}")
        self._enter("outside", "recorder", "--ros-args", *flags)
        output = ("--ros-args", "-p", f"recorder:output:={self.bag}")
        return super()._launch(executable, nodes, "--record", *output)

    def wait_until_matched(self) -> None:
        """Wait until this test and a recorder outside have met the publishers of the hand."""
        watched = {self.full(topic) for topic in self._types}
        mine = [each for each in self.node.subscriptions if each.topic_name in watched]
        self.wait(lambda: all(each.get_publisher_count() for each in mine), "the publishers")
        for topic in self.wait(self.published, "the nodes"):
            self.wait(lambda t=topic: self.hears("outside", t[1:]), f"the recorder of {topic}")


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
    with RecordedGraph(0.2, domain, tmp_path) as graph:
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
