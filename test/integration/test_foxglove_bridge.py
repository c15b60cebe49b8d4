# SPDX-License-Identifier: Apache-2.0
"""The bridge next to a real hand, and a client that speaks Foxglove's protocol."""

from __future__ import annotations

import asyncio
import json
import re
import struct
from collections.abc import Iterator
from functools import partial
from typing import Any

import aiohttp
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from support.graph import Graph

from bench.processes import isolated_domain, start_executable
from tactile_hand_ros import names
from tactile_hand_ros.scenario.scenario import load_scenario

SCENARIO = load_scenario("gravity", {"duration": 3600.0, "plant.speed": 1.0})
PATIENCE = 60.0  # s
OPTIONS = ("-p", "port:=0", "-p", "commands:=true")
ACCEPTED = {names.CONTROLLER: names.ACCEPTED_POSE, names.REGULATOR: names.ACCEPTED_FORCE}
SOCKET = r"foxglove: (ws://127\.0\.0\.1:\d+)"


class Client:
    """A client of Foxglove's WebSocket protocol, version foxglove.sdk.v1."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self.channels: dict[str, dict[str, Any]] = {}
        self.capabilities = ["unknown"]
        self._names: dict[int, str] = {}

    async def read(self) -> tuple[str, bytes]:
        """Return topic and data of the next message of a topic."""
        while True:
            message = await self._socket.receive(PATIENCE)
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
            if message.type is aiohttp.WSMsgType.BINARY:
                _, number, _ = struct.unpack_from("<BIQ", message.data)
                return self._names[number], message.data[13:]
            said = json.loads(message.data)
            self.capabilities = said.get("capabilities", self.capabilities)
            self.channels |= {each["topic"]: each for each in said.get("channels", [])}
            if said["op"] == "advertise":
                return "", b""

    async def show(self, *topics: str) -> None:
        while not set(topics) <= set(self.channels):
            await self.read()
        for topic in topics:
            number = len(self._names) + 1
            self._names[number] = topic
            wanted = {"id": number, "channelId": self.channels[topic]["id"]}
            await self._socket.send_json({"op": "subscribe", "subscriptions": [wanted]})

    async def first(self, topic: str) -> bytes:
        while True:
            name, data = await self.read()
            if name == topic:
                return data

    async def publish(self, number: int, topic: str, schema: str, data: bytes) -> None:
        channel = {"id": number, "topic": topic, "encoding": "cdr", "schemaName": schema}
        await self._socket.send_json({"op": "advertise", "channels": [channel]})
        await self._socket.send_bytes(struct.pack("<BI", 1, number) + data)


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Graph, str]]:
    folder = tmp_path_factory.mktemp("parameters")
    with (
        isolated_domain() as domain,
        start_executable("foxglove_bridge", "--ros-args", *OPTIONS) as bridge,
        Graph(SCENARIO, domain, folder, composed=True) as graph,
    ):
        bridge.wait_for_output("ws://", PATIENCE)
        yield graph, re.search(SOCKET, bridge.stdout)[1]  # type: ignore[index]
    assert bridge.returncode == 0


def talk(link: str, act: Any) -> Any:
    async def connected() -> Any:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(link, protocols=("foxglove.sdk.v1",)) as socket,
        ):
            return await asyncio.wait_for(act(Client(socket)), PATIENCE)

    return asyncio.run(connected())


def test_each_client_gets_topics_as_they_are_and_the_last_of_latched_ones(graph) -> None:
    async def act(client: Client) -> tuple[JointState, String]:
        await client.show("/joint_states", "/robot_description")
        found: dict[str, bytes] = {}
        while len(found) < 2:
            topic, data = await client.read()
            found[topic or "advertised"] = data
            found.pop("advertised", None)
        assert "sensor_msgs/msg/JointState" in client.channels["/joint_states"]["schemaName"]
        assert "float64[] position" in client.channels["/joint_states"]["schema"]
        assert not any("/_" in topic for topic in client.channels)
        joints = deserialize_message(found["/joint_states"], JointState)
        return joints, deserialize_message(found["/robot_description"], String)

    for _ in range(2):
        joints, description = talk(graph[1], act)
        assert len(joints.name) == len(joints.position) == 9
        assert description.data.lstrip().startswith("<")


def test_a_client_steers_the_hand_and_nothing_else(graph: tuple[Graph, str]) -> None:
    hand, link = graph
    pose, force = hand.newest(names.AUXILIARY_POSE), Float64(data=9.5)
    pose.pose.position.z += 0.003
    pose.header.stamp = Time()  # now

    async def act(client: Client) -> PoseStamped:
        await client.show("/accepted/desired_pose", "/accepted/user_grasp_force", "/joint_command")
        for node, topic in ACCEPTED.items():  # or an answer could be lost
            hand.wait(partial(hand.is_heard, node, topic), topic)
        torque = serialize_message(JointState(name=["other"], effort=[1.0]))
        await client.publish(1, "/joint_command", "sensor_msgs/msg/JointState", torque)
        await client.publish(2, "/desired_pose", "geometry_msgs/msg/PoseStamped", b"damaged")
        kind = "geometry_msgs/msg/PoseStamped"
        await client.publish(3, "/desired_pose", kind, serialize_message(pose))
        accepted = await client.first("/accepted/desired_pose")
        data = serialize_message(force)
        await client.publish(4, "/user_grasp_force", "std_msgs/msg/Float64", data)
        told = deserialize_message(await client.first("/accepted/user_grasp_force"), WrenchStamped)
        assert told.wrench.force.y == 9.5
        for _ in range(20):
            command = deserialize_message(await client.first("/joint_command"), JointState)
            assert "other" not in command.name
        return deserialize_message(accepted, PoseStamped)

    assert talk(link, act).pose.position == pose.pose.position
    hand.wait(lambda: hand.rejected("foxglove_bridge", "/joint_command") >= 1, "a refusal")
    hand.wait(lambda: hand.rejected(names.CONTROLLER, names.DESIRED_POSE) >= 1, "another")


@pytest.mark.usefixtures("domain")
def test_by_default_no_client_commands() -> None:
    """Any web page in a browser of this machine reaches the socket."""

    async def act(client: Client) -> list[str]:
        await client.read()
        return client.capabilities

    with start_executable("foxglove_bridge", "--ros-args", "-p", "port:=0") as bridge:
        bridge.wait_for_output("foxglove: ", PATIENCE)
        link = re.search(SOCKET, bridge.stdout)[1]  # type: ignore[index]
        assert talk(link, act) == []
