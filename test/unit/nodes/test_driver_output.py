# SPDX-License-Identifier: Apache-2.0
"""What drivers receive, by their own definitions of messages, also without commands."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState
from support.hands import write_hand
from support.messages import joint_message
from support.nodes import Process, counts, facts

from tactile_hand_ros.config.hand_config import DriverConfig
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.nodes import driver_output
from tactile_hand_ros.nodes.driver_output import DriverOutputNode, driver_message
from tactile_hand_ros.ros.endpoints import subscribe_directly, taken
from tactile_hand_ros.ros.qos import TICK_DEPTH

STORE, DIGITS = get_typestore(Stores.ROS2_JAZZY), "ah_messages/msg/Digits"
FLOATS = "std_msgs/msg/Float32MultiArray"
STORE.register(get_types_from_msg("uint8 reply_mode\nfloat32[] data", DIGITS))
JOINTS = [f"f{finger}_joint_{joint}" for finger in (1, 2, 3) for joint in (1, 2, 3)]
THETA, TORQUE = np.linspace(0.0, 0.8, 9), np.linspace(0.5, -0.3, 9)
TICK = 1_000_000_005  # ns


class Driver:
    """A driver and a controller around the node."""

    def __init__(self, here: Process, folder: Path, rate: float, kind: Any, **driver: Any) -> None:
        path = str(write_hand(folder, (3, 3, 3), driver={"topic": "command", **driver}))
        values = [Parameter("hand", value=path), Parameter("rate", value=rate)]
        self.node = DriverOutputNode(context=here.context, parameter_overrides=values)
        here.add(self.node)
        self.here, self.sent, user, depth = here, 0, here.user, TICK_DEPTH
        self.name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        self.end = subscribe_directly(user, kind, "command", depth)
        self.joints = user.create_publisher(JointState, "joint_states", depth)
        self.senders = [user.create_publisher(JointState, "joint_command", depth) for _ in "ab"]
        here.wait(self.end.get_publisher_count, "the output")
        for each in (self.joints, *self.senders):
            here.wait(each.get_subscription_count, each.topic_name)

    def command(self, late: int = 0, torque=TORQUE, names=JOINTS, by: int = 0) -> None:
        self.senders[by].publish(joint_message(names, TICK - late, effort=torque))
        self.sent += 1

    def rejected(self) -> int:
        """Wait until the node has received all commands, and return how many it rejected."""
        self.here.wait(lambda: int(facts(self.node)["ticks"]) + self._refused() == self.sent)
        return self._refused()

    def _refused(self) -> int:
        return counts(self.node, "rejected").get("joint_command", 0)

    def received(self) -> list[Any]:
        return [STORE.deserialize_cdr(data, self.name) for data, _ in taken(self.end)]

    def answer(self) -> Any:
        """Send joint states, and a command until one is answered: it may arrive before them."""
        states = joint_message(["arm", *JOINTS[::-1]], TICK, position=[9.0, *THETA[::-1]])
        self.joints.publish(states)
        return self.here.wait(lambda: self.command() or self.received(), "an answer")[-1]


@pytest.mark.parametrize("message", ["joint_state", "float64_array", FLOATS])
def test_a_driver_receives_positions_in_its_type(here, tmp_path, message) -> None:
    choice = {"output": "position", "message": message}
    kind, _ = driver_message(DriverConfig(**choice), JOINTS)
    driver = Driver(here, tmp_path, 0.1, kind, stiffness=2.0, **choice)
    (silence,) = (t for t in driver.node.timers if t.timer_period_ns == 30_000_000_000)
    end = time.monotonic_ns() + silence.time_until_next_call()
    got = driver.answer()
    later = time.monotonic_ns() + silence.time_until_next_call() - end
    assert later > 1_000_000  # ns: the command has put off the end of patience
    values = got.position if message == "joint_state" else got.data
    np.testing.assert_allclose(values, THETA + TORQUE / 2.0, rtol=1e-6)
    if message == "joint_state":
        assert (got.name, got.header.stamp.nanosec) == (JOINTS, 5)
        assert not got.velocity.size and not got.effort.size


def test_a_vendor_type_is_filled_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The type is built from the vendor's definition, here as part of another one."""
    vendor = DriverConfig(message=DIGITS, field="hand.data")
    with pytest.raises(TactileHandError, match=f"'{DIGITS}' is not installed; install or source"):
        driver_message(vendor, JOINTS)
    with pytest.raises(TactileHandError, match="'my_float64_array/msg/Digits' is not installed"):
        driver_message(DriverConfig(message="my_float64_array/msg/Digits"), JOINTS)
    with pytest.raises(ConfigurationError, match="a float array of std_msgs.*has layout, data"):
        driver_message(DriverConfig(message=FLOATS, field="layout.data_offset"), JOINTS)
    blank = STORE.types[DIGITS](reply_mode=0, data=np.zeros(0))
    blank.get_fields_and_field_types = lambda: {"reply_mode": "uint8", "data": "sequence<float>"}
    outer = SimpleNamespace(hand=blank)
    monkeypatch.setattr(driver_output, "message_class", lambda _: lambda: outer)
    assert driver_message(vendor, JOINTS)[1](0, np.array([1.0, 2.0])) is outer
    blank.data = np.array(blank.data, np.float32)
    data = bytes(STORE.serialize_cdr(blank, DIGITS))
    assert data.hex() == "0001000000000000020000000000803f00000040"


def test_unusable_commands_are_counted_and_never_sent(here: Process, tmp_path: Path) -> None:
    """Meanwhile, from three ticks of 10 ms after the last good one on, the driver receives 0."""
    driver = Driver(here, tmp_path, 100.0, JointState)
    node, wait = driver.node, here.wait
    node.to_safe_state("no command yet")
    driver.command(late=TICK)  # without joint states
    assert driver.rejected() == 1 and "fault hold" not in facts(node) and not driver.received()
    np.testing.assert_array_equal(driver.answer().effort, TORQUE)
    before, _ = driver.rejected(), driver.received()
    wait(lambda: any(not m.effort.any() for m in driver.received()), "zeros")
    assert facts(node)["fault hold"].startswith("no usable joint_command for 3 ticks; the driver")
    driver.command(late=30_000_001)
    driver.command(late=-30_000_001)
    wait(lambda: "30.000 ms newer" in facts(node).get("last reason joint_command", ""), "newer")
    driver.command(torque=[np.nan, *TORQUE[1:]])
    driver.command(torque=TORQUE[1:], names=JOINTS[1:])
    assert driver.rejected() == before + 4
    assert not any(message.effort.any() for message in driver.received())
    driver.command(late=30_000_000)
    wait(lambda: any(m.effort.any() for m in driver.received()), "the oldest good command")
    wait(lambda: driver.command() or "fault hold" not in facts(node), "the end of the hold")

    def is_contested() -> bool:
        driver.command()
        driver.command(by=1)
        return "two senders" in facts(node).get("last reason joint_command", "")

    wait(is_contested, "the conflict")
