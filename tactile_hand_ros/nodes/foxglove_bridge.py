# SPDX-License-Identifier: Apache-2.0
"""The bridge to Lichtblick, Foxglove and PlotJuggler: all topics as they are, on a WebSocket."""

from __future__ import annotations

from collections import deque
from typing import Any

from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64

from tactile_hand_ros import names
from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.errors import BagError, ConfigurationError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.nodes.recorder.config import TopicSelection
from tactile_hand_ros.nodes.recorder.topic import RawTopic
from tactile_hand_ros.ros import qos
from tactile_hand_ros.ros.node import TactileNode

ADDRESS = "127.0.0.1"
"""Whoever reaches the socket sees everything, since its protocol has no authentication."""

_PERIOD = 1.0 / 60.0  # s between two deliveries
_DISCOVERY_PERIOD = 0.5  # s between two searches for new topics
_DEPTH = 1000  # messages of a topic that wait for a delivery
_EVERY_TOPIC = TopicSelection([".*"])


class FoxgloveBridgeConfig(Config):
    """Configuration of the bridge."""

    port: int = param(8765, "port on this machine, 0 for any free one", ge=0, le=65535)
    commands: bool = param(
        False, "let clients command poses and grasp forces, any web page in your browser included"
    )


class _Client:
    """What clients ask for, in threads of the server."""

    def __init__(self) -> None:
        self.subscribed: deque[str] = deque()
        self.sent: deque[tuple[str, bytes]] = deque()
        self._topics: dict[tuple[int, int], str] = {}

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self.subscribed.append(channel.topic)

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        self._topics[client.id, channel.id] = channel.topic

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        if (client.id, client_channel_id) in self._topics:
            self.sent.append((self._topics[client.id, client_channel_id], data))

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        self._topics.pop((client.id, client_channel_id), None)

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Do nothing: a channel without sinks is noticed at the next delivery."""


class FoxgloveBridgeNode(TactileNode[FoxgloveBridgeConfig]):
    """Offers every topic of the graph on a WebSocket, in the protocol of Foxglove.

    A topic is subscribed while a client shows it. With `commands`, clients may publish
    `desired_pose` and `user_grasp_force`; the nodes that receive these check them.

    Publications: `desired_pose` (geometry_msgs/PoseStamped), `user_grasp_force` (std_msgs/Float64),
    `/diagnostics`.

    Parameters: the fields of `FoxgloveBridgeConfig`.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Start the server.

        Raises:
            MissingLibraryError: If foxglove-sdk is not installed.
        """
        super().__init__("foxglove_bridge", FoxgloveBridgeConfig, **kwargs)
        self._sdk = optional("foxglove", "The bridge", "foxglove-sdk")
        self._sdk.set_log_level("CRITICAL")  # a client that leaves is not an error
        self._hub, self._listener = self._sdk.Context(), _Client()
        self._offered: dict[str, Any] = {}  # channels by topic, None of an unknown type
        self._shown: dict[str, RawTopic] = {}
        pose = self.create_publisher(PoseStamped, names.DESIRED_POSE, qos.USER_DEPTH)
        force = self.create_publisher(Float64, names.USER_GRASP_FORCE, qos.USER_DEPTH)
        self._commands = {each.topic_name: each for each in (pose, force)}
        try:
            self._server = self._sdk.start_server(
                name="tactile_hand_ros",
                host=ADDRESS,
                port=self.config.port,
                capabilities=[self._sdk.Capability.ClientPublish] * self.config.commands,
                supported_encodings=["cdr"],
                server_listener=self._listener,
                context=self._hub,
            )
        except (RuntimeError, OSError) as error:
            raise ConfigurationError(
                f"port: {self.config.port} cannot be used ({error}); choose another, or 0."
            ) from None
        print(f"foxglove: ws://{ADDRESS}:{self._server.port}", flush=True)
        self.create_timer(_DISCOVERY_PERIOD, self._discover)
        self.create_timer(_PERIOD, self._deliver)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def _discover(self) -> None:
        """Offer new topics, and follow publishers that come and go."""
        for name, types in self.get_topic_names_and_types():
            if name not in self._offered and name in _EVERY_TOPIC:
                self._offered[name] = self._channel(name, types[0])
        for topic in self._shown.values():
            topic.adapt(self._send)

    def _channel(self, name: str, type_name: str) -> Any:
        try:
            found = message_definition(type_name)
        except BagError as error:
            self.get_logger().warning(f"{name} is not offered: {error}")
            return None
        kind = self._sdk.Schema(name=type_name, encoding=found.encoding, data=found.text.encode())
        return self._sdk.Channel(name, message_encoding="cdr", schema=kind, context=self._hub)

    def _deliver(self) -> None:
        while self._listener.subscribed:
            name = self._listener.subscribed.popleft()
            # Subscribe again for each client: each then gets the last message of a latched topic.
            if name in self._shown:
                self._shown.pop(name).close()
            self._shown[name] = RawTopic(self, name, self._offered[name].schema_name(), _DEPTH)
        for name, topic in list(self._shown.items()):
            topic.drain(self._send)
            if not self._offered[name].has_sinks():
                self._shown.pop(name).close()
        while self._listener.sent:
            name, data = self._listener.sent.popleft()
            if name in self._commands:
                self._commands[name].publish(data)
            else:
                expected = " or ".join(self._commands)
                self.reject(name, f"a client published on '{name}', expected {expected}")

    def _send(self, topic: RawTopic, data: bytes, received: int, sent: int) -> None:
        self._offered[topic.name].log(data, log_time=received)
        self.diagnostics.tick()
