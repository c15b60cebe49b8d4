# SPDX-License-Identifier: Apache-2.0
"""User changes in a run take effect exactly at their ticks."""

from pathlib import Path

import numpy as np
import pytest
from support.messages import force_message, pose_message
from support.recorded import (
    PERIOD,
    START,
    RunWriter,
    parameter_event,
    random_record,
    request_message,
    write_tick,
)

from tactile_hand_ros.errors import BagError
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved
from tactile_hand_ros.verify.recorded_inputs import PARAMETERS, read_inputs

SCENARIO = load_scenario("paper", {"duration": 0.1, "targets": []})


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Return the last of two runs in a bag, both with user changes."""
    record = random_record(12)
    record.contact_positions[4, 1] = record.contact_quaternions[4, 1] = np.nan
    record.forces[6, 2, 1] = np.nan
    turn = (0.6, 0.0, 0.0, 0.8)
    with RunWriter(tmp_path / "bag", {"scenario": resolved(SCENARIO)}) as bag:
        for section in range(2):
            begin = START + section * 10**9
            for row in range(len(record)):
                write_tick(bag, record, row, begin + row * PERIOD)
            at, number = begin + 5 * PERIOD, 1.0 + section
            stamp = 2_000_000 * (3 + section)
            for topic, content in (
                ("desired_pose", pose_message((number, 0.2, 0.3), turn, stamp)),
                ("user_grasp_force", force_message((9.0, number, 9.0), stamp)),
                (
                    "manipulation_controller/parameters",
                    parameter_event(10**9 * (1 - section) + 7, "x", {"law.k_p": number}),
                ),
                ("manipulation_controller/requests", request_message(stamp, "", "grasp", "true")),
                ("slip_regulator/requests", request_message(stamp, "", "reset")),
            ):
                bag.write(f"/accepted/{topic}", content, at)
    return Run(tmp_path)


def test_the_inputs_are_those_of_the_last_run_in_a_bag(run):
    inputs = read_inputs(run, SCENARIO)
    assert len(inputs.contacts) == len(inputs.measured) == 12 and None not in inputs.contacts
    assert inputs.contacts[4].touching.tolist() == [True, False, True]
    assert inputs.measured.tolist() == [row != 6 for row in range(12)]
    config, call, pose = inputs.changes["manipulation_controller"]
    assert (config.stamp, config.value.law.k_p) == (7, 2.0)
    assert call == (8_000_000, "grasp", True)
    assert (pose.stamp, pose.value.position.tolist()) == (8_000_000, [2.0, 0.2, 0.3])
    assert pose.value.orientation[2, 1] == pytest.approx(2.0 * 0.6 * 0.8)
    assert inputs.changes["slip_regulator"] == [
        (0, PARAMETERS, SCENARIO.slip_regulator),
        (8_000_000, "reset", False),
        (8_000_000, "grasp_force", 2.0),
    ]
    assert len(inputs.changes["force_optimizer"]) == 1 and not inputs.may_skip
    other = load_scenario("paper", {"plant.pacing": "realtime"})
    assert read_inputs(run, other).may_skip


@pytest.mark.parametrize("kind", [0, 10])
def test_a_parameter_of_an_unknown_type_is_a_broken_bag(tmp_path, kind):
    event = parameter_event(7, "x", {"law.k_p": 1.0})
    event.changed_parameters[0].value.type = kind
    with RunWriter(tmp_path / "bag", {"scenario": resolved(SCENARIO)}) as bag:
        write_tick(bag, random_record(1), 0, START)
        bag.write("/accepted/manipulation_controller/parameters", event, START)
    with pytest.raises(BagError, match=f"'law.k_p' has the type {kind}, expected 1 to 9"):
        read_inputs(Run(tmp_path), SCENARIO)
