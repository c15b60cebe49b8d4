# SPDX-License-Identifier: Apache-2.0
"""The driver output: sends each torque to a driver as position, velocity, current or effort.

Safe state: after `age_limit` ticks without a usable `joint_command`, the driver receives its last
position again, or 0 for the other outputs. Servos then hold the grasp; without torque, an object
falls. If this node crashes, the driver must act on the silence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from tactile_hand_ros import names
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.config.hand_config import DriverConfig, load_hand_config
from tactile_hand_ros.config.model import Config, param
from tactile_hand_ros.control.driver_output import DriverOutput
from tactile_hand_ros.errors import ConfigurationError, MessageError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.ros.endpoints import message_class
from tactile_hand_ros.ros.messages import JointCodec
from tactile_hand_ros.ros.node import TactileNode
from tactile_hand_ros.ros.ticks import SenderCheck, two_senders

Encode = Callable[[int, Array], Any]  # from a timestamp [ns] and n numbers to a message or bytes


class DriverOutputConfig(Config):
    """Configuration of the driver output; the hand's file describes the driver."""

    hand: str = param("paper", "hand by name or YAML file")
    rate: float = param(500.0, "ticks per second", unit="Hz", gt=0.0, le=10_000.0)
    age_limit: int = param(3, "largest age of a command", unit="ticks", ge=1, le=1000)


class DriverOutputNode(TactileNode[DriverOutputConfig]):
    """Sends each `joint_command` to the driver as soon as it arrives.

    Subscriptions: `joint_command` (sensor_msgs/JointState, effort by joint name, N m; stamped with
    the tick that it answers), `joint_states` (sensor_msgs/JointState, rad).

    Publication: `driver.topic` of the hand's file, in the driver's type, order and units, stamped
    with the tick where the type has a header. Once a second: `/diagnostics`.

    Parameters: the fields of `DriverOutputConfig`.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Create the topics of the `driver` in the hand's file."""
        super().__init__("driver_output", DriverOutputConfig, **kwargs)
        c, hand = self.config, Hand.load(self.config.hand)
        driver = load_hand_config(c.hand).driver
        if not driver.topic:
            raise ConfigurationError(f"driver.topic is missing in the hand '{c.hand}'; set it.")
        self._law = DriverOutput(driver, hand)
        kind, self._encode = driver_message(driver, self._law.joints)
        self._publisher = self.create_publisher(kind, driver.topic, 1)
        self._newest, self._theta, self._senders = -1, np.zeros(hand.joints), SenderCheck()
        self._tick = round(1e9 / c.rate)  # ns
        self._angles = JointCodec(hand.joint_names, ("position",), others=True)
        self._torques = JointCodec(hand.joint_names, ("effort",))
        self.subscribe(JointState, names.JOINT_STATES, self._on_joints, sensor=True, raw=True)
        self.subscribe(JointState, names.JOINT_COMMAND, self._on_command, raw=True)
        silence = f"no usable {names.JOINT_COMMAND} for {c.age_limit} ticks"
        hold = partial(self.to_safe_state, silence)
        self._silence = self.create_timer(c.age_limit / c.rate, hold)

    def _on_joints(self, data: bytes) -> None:
        self._newest, (self._theta,) = self._angles.decode(data)

    def _on_command(self, data: bytes, info: Mapping[str, Any]) -> None:
        if self._senders.note(info):
            raise MessageError(two_senders(names.JOINT_COMMAND))
        stamp, (torque,) = self._torques.decode(data)
        age, limit = self._newest - stamp, self.config.age_limit
        if self._newest < 0:
            raise MessageError("no joint_states yet, expected them before any command.")
        if abs(age) > limit * self._tick:  # below 0 if joint states are late
            raise MessageError(
                f"the command is {1e-6 * abs(age):.3f} ms {'older' if age > 0 else 'newer'} than "
                f"the newest joint_states, expected at most {limit} ticks older or newer; check "
                "stamps, rate and the computer's load."
            )
        with self.answering():
            self._publisher.publish(self._encode(stamp, self._law.step(self._theta, torque)))
        self._silence.reset()
        self.diagnostics.clear("hold")
        self.diagnostics.value("clipped_outputs", self._law.clipped)

    def to_safe_state(self, reason: str) -> None:
        """Send the last position, or 0 for the other outputs; nothing before the first command."""
        output = self._law.rest()
        if output.size:
            self._publisher.publish(self._encode(self._newest, output))
            self.diagnostics.fault("hold", f"{reason}; the driver receives its last position or 0")


def driver_message(driver: DriverConfig, joints: Sequence[str]) -> tuple[Any, Encode]:
    """Return the type of a driver's commands, and how to make one.

    Raises:
        TactileHandError: If the type is not installed or has no such array.
    """
    if driver.message == "joint_state":
        field = "effort" if driver.output == "current" else driver.output
        return JointState, JointCodec(joints, (field,)).encode
    is_plain = driver.message == "float64_array"
    name = "std_msgs/msg/Float64MultiArray" if is_plain else driver.message
    kind = message_class(name)
    message: Any = kind()
    holder, (*parents, last) = message, driver.field.split(".")
    for parent in parents:
        holder = getattr(holder, parent, None)
    fields: dict[str, str] = getattr(holder, "get_fields_and_field_types", dict)()
    if fields.get(last) not in ("sequence<float>", "sequence<double>"):
        raise ConfigurationError(
            f"driver.field is '{driver.field}', expected a float array of {name}, which has "
            f"{', '.join(kind.get_fields_and_field_types())}."
        )

    def encode(stamp: int, values: Array) -> Any:
        setattr(holder, last, values.tolist())
        return message

    return kind, encode
