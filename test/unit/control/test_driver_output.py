# SPDX-License-Identifier: Apache-2.0
"""What a driver receives for a torque, at the limits of the hand too."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.hands import write_hand

from tactile_hand_ros.config.hand_config import DriverConfig
from tactile_hand_ros.config.model import validate
from tactile_hand_ros.control.driver_output import DriverOutput
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.hand.hand import Hand

FOLLOWER = {"f1_joint_4": {"joint": "f1_joint_3", "ratio": 0.5, "offset": 0.1}}
LIMITS = {"f2_joint_1": {"lower": -0.2, "upper": 0.4, "effort": 0.5, "velocity": 2.0}}
OURS = [f"f{finger}_joint_{joint}" for finger in (1, 2, 3) for joint in (1, 2, 3)]
NAMES = {name: f"d{i}" for i, name in enumerate(["f1_joint_4", "ring", *OURS[::-1]])}
OTHERS = {"names": NAMES, "fixed": {"ring": 0.7}}
THETA = np.linspace(-0.4, 1.2, 9)
TORQUE = np.array([0.1, -0.2, 0.3, 0.4, 0.0, -0.5, 0.6, -0.7, 0.8])


def law(folder: Path, **driver: Any) -> DriverOutput:
    """Return the law of a hand whose joint 4 of the first finger follows joint 3."""
    path = str(write_hand(folder, (4, 3, 3), couplings=FOLLOWER, limits=LIMITS))
    return DriverOutput(validate(DriverConfig, driver), Hand.load(path))


def test_a_position_servo_applies_the_torque(tmp_path: Path) -> None:
    stiffness = {name: 1.0 + i for i, name in enumerate(OURS)}
    servo = law(tmp_path, output="position", degrees=True, stiffness=stiffness, **OTHERS)
    assert servo.rest().size == 0 and servo.joints == list(NAMES.values())
    follower, ring, *goal = np.radians(servo.step(THETA, TORQUE))
    expected = THETA + TORQUE / np.arange(1.0, 10.0)
    np.testing.assert_allclose(goal[::-1], expected)
    np.testing.assert_allclose((follower, ring), (0.5 * expected[2] + 0.1, 0.7))
    np.testing.assert_array_equal(servo.rest(), servo.step(THETA, TORQUE))
    np.testing.assert_allclose(np.radians(servo.step(THETA, 0.0 * TORQUE))[:1:-1], THETA)
    assert servo.clipped == 0


@pytest.fixture(scope="module")
def soft(tmp_path_factory: pytest.TempPathFactory) -> DriverOutput:
    return law(tmp_path_factory.mktemp("hand"), output="position", stiffness=0.8)


@given(st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
def test_limits_only_weaken_the_torque_of_a_servo(
    soft: DriverOutput, angle: float, torque: float
) -> None:
    """Outside its range, too, where a goal at the limit would be a torque of its own."""
    theta, before = np.full(9, angle), soft.clipped
    applied = 0.8 * (soft.step(theta, np.full(9, torque)) - theta)[3]
    is_possible = abs(torque) <= 0.5 and -0.2 <= angle + torque / 0.8 <= 0.4
    assert abs(applied) <= min(abs(torque), 0.5) + 1e-9 and applied * torque >= 0.0
    if is_possible:
        assert applied == pytest.approx(torque, abs=1e-9)
    elif -0.2 <= angle <= 0.4:
        assert -0.2 - 1e-9 <= angle + applied / 0.8 <= 0.4 + 1e-9
        assert soft.clipped == before + 1


@pytest.mark.parametrize(
    ("driver", "factor", "largest"),
    [
        ({"output": "velocity", "damping": 0.1}, 10.0, 2.0),
        ({"output": "velocity", "damping": 0.1, "degrees": True}, 1800 / np.pi, 360 / np.pi),
        ({"output": "current", "torque_constant": 0.2, "degrees": True}, 5.0, 2.5),
        ({"output": "effort"}, 1.0, 0.5),
    ],
)
def test_the_other_outputs_are_proportional_and_rest_at_zero(
    tmp_path: Path, driver: dict[str, Any], factor: float, largest: float
) -> None:
    """Each up to its limit; a joint that follows gets its speed, but no torque of its own."""
    motor = law(tmp_path, **OTHERS, **driver)
    follower, ring, *rest = motor.step(THETA, 0.3 * TORQUE)
    np.testing.assert_allclose(rest[::-1], 0.3 * factor * TORQUE)
    half = 0.5 * (driver["output"] == "velocity")
    assert (follower, ring) == (pytest.approx(half * 0.09 * factor), 0.0) and not motor.clipped
    assert motor.step(THETA, 20.0 * TORQUE)[-4] == pytest.approx(largest) and motor.clipped == 1
    np.testing.assert_array_equal(motor.rest(), np.zeros(11))


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        ({"output": "position"}, "driver.stiffness has values for no joint, but the output 'posi"),
        ({"output": "current", "torque_constant": {"f1_joint_1": 1.0}}, "for each of f1_joint_1, "),
        ({"output": "velocity", "damping": 0.0}, r"damping.\* is 0.0, .* greater than 0"),
        ({"names": {"f1_joint_1": "a"}}, "driver.names lacks 'f1_joint_2', expected each of f1_"),
        ({"names": {**NAMES, "f9": "a"}}, "driver.names has 'ring', expected each of f1_joint_1,"),
    ],
)
def test_a_driver_that_does_not_fit_the_hand_is_refused(
    tmp_path: Path, driver: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        law(tmp_path, **driver)
