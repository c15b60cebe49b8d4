# SPDX-License-Identifier: Apache-2.0
"""Bytes that are no message, and floods: no node ends, and the grip stays."""

import signal
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64
from support.graph import Graph
from support.messages import pose_message

from bench.processes import isolated_domain
from tactile_hand_ros import names
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.endpoints import message_class
from tactile_hand_ros.ros.node import SUBSCRIPTIONS
from tactile_hand_ros.scenario.scenario import NODES, load_scenario

P_D = np.array(load_scenario("paper").targets[0].position)
ENDLESS = {"duration": 86400.0, "plant.autostart": False, "plant.rate": 250.0}
CUT = b"\x00\x01\x00\x00\x01\x00"
NO_MESSAGES = (CUT, b"\x00\x01\x00\x00" + b"\xff" * 500, bytes(1_000_000))
LOG_LIMIT = 60_000  # characters that a node may write during all of this


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """Run the paper's scenario without end, and insist that all survive and say little."""
    folder = tmp_path_factory.mktemp("graph")
    with isolated_domain() as domain, Graph(load_scenario("paper", ENDLESS), domain, folder) as run:
        run.begin(P_D)
        run.wait(lambda: run.time > 0.1, "the first ticks")
        yield run
        assert set(run.end(signal.SIGINT).values()) == {0}
        for name, process in run.processes.items():
            assert "Traceback" not in process.stderr, name
            assert len(process.stderr) + len(process.stdout) < LOG_LIMIT, name


@pytest.fixture(autouse=True)
def held(graph: Graph) -> Iterator[None]:
    """Insist that nothing unforeseen happened, ticks go on, and all fingers still hold."""
    yield
    until = graph.time + 0.2
    graph.wait(lambda: graph.time > until, "ticks after the attack")
    normal = graph.forces[:, 1]
    assert (normal > 0.5).all() and (normal < 20.0).all()
    for name in NODES:
        assert not [key for key in graph.health[f"/{name}"].values if key.startswith("errors")]


def inputs(graph: Graph) -> dict[str, list[str]]:
    """Return all topics that the five nodes read, each with its readers."""
    found: dict[str, list[str]] = {}
    for name in NODES:
        for key in graph.health[f"/{name}"].values:
            if key.startswith(f"{SUBSCRIPTIONS} "):
                topic = key.removeprefix(f"{SUBSCRIPTIONS} /")
                found.setdefault(topic, []).append(name)
    return found


def attack(graph: Graph, attacks: dict[str, list[bytes]]) -> None:
    """Send bytes on topics and wait until every reader has refused each of them."""
    readers = inputs(graph)
    before = {(name, t): graph.rejected(name, t) for t in attacks for name in readers[t]}
    kinds = {topic: message_class(kind) for topic, [kind] in graph.node.get_topic_names_and_types()}
    made = {t: graph.node.create_publisher(kinds[f"/{t}"], t, qos.user_qos()) for t in attacks}
    watched = {t: graph.node.count_subscribers(t) for t in attacks}
    for topic, publisher in made.items():
        graph.wait(
            lambda p=publisher, t=topic: p.get_subscription_count() >= watched[t],
            f"readers of {topic}",
        )
    for topic, messages in attacks.items():
        for data in (*messages, b""):  # nothing at all does not arrive; it must not hurt either
            made[topic].publish(data)
    for (name, topic), count in before.items():
        wanted = count + len(attacks[topic])
        graph.wait(lambda n=name, t=topic, k=wanted: graph.rejected(n, t) == k, f"{name}, {topic}")
    for publisher in made.values():
        graph.node.destroy_publisher(publisher)


def test_bytes_that_are_no_message_are_counted_on_every_input(graph):
    topics = inputs(graph)
    assert len(topics) >= 16  # of five nodes and three fingers
    attacks = {topic: list(NO_MESSAGES) for topic in topics}
    attacks[names.USER_GRASP_FORCE] = [CUT, CUT]  # Fast DDS sends no more than the type can have
    del attacks[names.JOINT_HOLD]  # any byte is a Bool
    del attacks[names.TOUCH_REJECTED]  # ROS drops what is no text, uncounted
    attack(graph, attacks)


def floods(graph: Graph) -> dict[str, tuple[str, Any]]:
    """Return topic and message of each flood: what a user may send, far too often."""
    ahead = round(1e9 * graph.time) + 3600 * 10**9
    return {
        "future poses": (names.DESIRED_POSE, pose_message(P_D, np.eye(3), ahead)),
        "poses out of reach": (names.DESIRED_POSE, pose_message((0.5, 0.5, 0.5), np.eye(3), 0)),
        "poses": (names.DESIRED_POSE, pose_message(P_D, np.eye(3), 0)),
        "grasp forces": (names.USER_GRASP_FORCE, Float64(data=10.0)),
        "megabytes": (names.DESIRED_POSE, pose_message(P_D, np.eye(3), 0, frame="x" * 1_000_000)),
    }


@pytest.mark.parametrize(
    "which", ["future poses", "poses out of reach", "poses", "grasp forces", "megabytes"]
)
def test_a_flood_costs_ticks_and_not_the_grip(graph, which):
    """At 2500 messages a second, megabytes at 50, the ticks do not stand still."""
    topic, message = floods(graph)[which]
    publisher = graph.node.create_publisher(type(message), topic, qos.user_qos())
    graph.wait(lambda: publisher.get_subscription_count() > 0, f"a reader of {topic}")
    data, sent = serialize_message(message), list[int]()
    burst, enough = (1, 15) if which == "megabytes" else (25, 700)
    is_over = threading.Event()

    def send() -> None:
        if not is_over.is_set():
            sent.extend(publisher.publish(data) or 1 for _ in range(burst))

    timer = graph.node.create_timer(0.02 if burst == 1 else 0.01, send)
    until = graph.time + 0.2
    graph.wait(lambda: graph.time > until and len(sent) > enough, "ticks during the flood")
    is_over.set()
    last = graph.time  # a newer tick is taken after the last call of `send`
    graph.wait(lambda: graph.time > last, "the end of the flood")
    graph.node.destroy_timer(timer)
    graph.node.destroy_publisher(publisher)
