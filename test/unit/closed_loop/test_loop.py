# SPDX-License-Identifier: Apache-2.0
"""The complete loop: determinism, other hands, the record, lost contacts, and blindness."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.hands import prism_grasp
from support.recorded import assert_same

from tactile_hand_ros.closed_loop.loop import Chain, ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.run.derived import dropped_at
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import load_scenario

NOISY = {
    "tactile_sensor.force_noise": 0.02,
    "tactile_sensor.location_noise": 0.0002,
    "tactile_sensor.dropout": 0.1,
    "manipulation_controller.midpoint_hold": False,
}


def run(name="paper", ticks=100, **changes):
    return ClosedLoop(load_scenario(name, changes.get("changes"))).run(ticks)


def arrays(record):
    return {name: value for name, value in vars(record).items() if isinstance(value, np.ndarray)}


def test_equal_seeds_give_equal_bits_and_others_do_not():
    first, second = run(changes=NOISY), run(changes=NOISY)
    assert_same(first, second)
    other = run(changes={**NOISY, "seed": 2})
    assert np.abs(other.object_position - first.object_position).max() > 1e-9


def test_a_run_may_be_continued():
    whole, loop = run(ticks=60), ClosedLoop(load_scenario("paper"))
    first, rest = loop.run(20), loop.run(40)
    for name, value in arrays(whole).items():
        joined = np.concatenate([getattr(first, name), getattr(rest, name)])
        np.testing.assert_array_equal(value, joined, err_msg=name)


def test_the_record_is_complete_and_consistent():
    record = run(ticks=50)
    assert len(record) == 50
    np.testing.assert_array_equal(record.stamps, 2_000_000 * np.arange(50))
    np.testing.assert_allclose(record.times, 0.002 * np.arange(50))
    for name, value in arrays(record).items():
        assert np.isfinite(value).all() or name == "palm", name  # the palm does not turn
    # A command acts until the next tick.
    np.testing.assert_array_equal(record.torque[1:], record.command[:-1])
    np.testing.assert_array_equal(record.torque[0], 0.0)
    # A perfect skin reports the truth.
    np.testing.assert_array_equal(record.contact_positions, record.true_positions)
    np.testing.assert_array_equal(record.forces, record.true_forces)
    centroids = record.contact_positions.mean(axis=1)
    np.testing.assert_allclose(record.auxiliary_position, centroids, atol=1e-15)
    np.testing.assert_array_equal(record.desired_position, [[-0.1, 0.2, 0.4]] * 50)


def test_a_target_is_recorded_from_the_tick_it_holds():
    first, second = [0.0, 0.05, 0.41], [0.0, 0.06, 0.41]
    targets = [{"time": 0.05, "position": first}, {"time": 0.08, "position": second}]
    record = run(ticks=50, changes={"targets": targets})
    assert np.isnan(record.desired_position[:25]).all()
    np.testing.assert_array_equal(record.desired_position[25:40], [first] * 15)
    np.testing.assert_array_equal(record.desired_position[40:], [second] * 10)
    still = np.abs(record.object_position[:26] - record.object_position[0]).max()
    assert still < 1e-6 < np.abs(record.object_position[-1] - record.object_position[0]).max()


@pytest.mark.parametrize(
    "joints", [[3, 4, 5], [3, 3, 4, 5], [3, 3, 3, 4, 5]], ids=["three", "four", "five"]
)
def test_other_hands_hold_and_turn_other_objects(tmp_path, joints):
    """Fingers of 3 to 5 joints around a prism with as many sides; only the files differ."""
    values = {
        **prism_grasp(tmp_path, joints),
        "plant.object.mass": 0.1,
        "manipulation_controller.law.k_p": 30.0,
        "manipulation_controller.law.k_o": 3.0,
        "manipulation_controller.law.damping": 0.3,
        "duration": 3.0,
    }
    # R_pod is that of the contacts' frame, whose initial value follows from their positions.
    start = ClosedLoop(load_scenario("paper", {**values, "targets": []})).run(1)
    turn = Rotation.from_rotvec([0.0, 0.0, 0.05])
    wanted = turn * Rotation.from_quat(start.auxiliary_quaternion[0])
    target = {"position": [0.01, -0.01, 0.41], "rotation": wanted.as_rotvec().tolist()}
    scenario = load_scenario("paper", {**values, "targets": [target]})
    check_scenario(scenario)
    record = ClosedLoop(scenario).run()
    assert np.isfinite(record.true_positions).all()
    assert np.linalg.norm(record.auxiliary_position[-1] - target["position"]) < 2e-3
    missing = wanted * Rotation.from_quat(record.auxiliary_quaternion[-1]).inv()
    assert missing.magnitude() < 5e-3
    carried = Rotation.from_quat(record.object_quaternion[-1]).as_rotvec()
    np.testing.assert_allclose(carried, [0.0, 0.0, 0.05], atol=0.02)
    optimal, pressed = record.optimal_forces[-1, :, 1], record.true_forces[-1, :, 1]
    np.testing.assert_allclose(optimal.sum(), 1.0, atol=1e-9)
    assert optimal.min() > 0.5 / len(joints)
    np.testing.assert_allclose(pressed, 10.0 * optimal, atol=0.1)


def test_the_users_grasp_forces_are_taken_in_order_of_time_at_their_tick():
    asked = [{"time": 0.008, "force": 14.0}, {"time": 0.004, "force": 8.0}]
    loop = ClosedLoop(load_scenario("paper", {"user_forces": asked, "targets": []}))
    goals, forces = [], []
    for _ in range(6):
        forces.append(loop.run(1).grasp_force[0])
        goals.append(loop.regulator.goal)
    assert goals == [10.0, 10.0, 8.0, 8.0, 14.0, 14.0]
    assert (np.diff(forces) < 0.0).tolist() == [False, True, True, False, False]


def test_what_is_recorded_of_a_tick_is_what_the_blocks_say():
    loop = ClosedLoop(load_scenario("paper", {"slip_regulator.mode": "auto"}))
    hand = loop.plant.hand
    record = Record.empty(60, hand.finger_names, hand.joint_names)
    for row in range(60):
        state, stamp = loop.state, loop.stamp
        command = loop.answer(record, row)
        assert record.stamps[row] == stamp == loop.scenario.plant.tick * row
        expected = {
            "theta": state.theta,
            "rates": state.rates,
            "torque": state.joints.applied,
            "command": command.torque,
            "object_position": state.position,
            "true_positions": state.contacts.positions,
            "true_forces": state.forces,
            "true_slid": state.slid,
            "true_sliding": np.hypot(state.sliding[:, 0], state.sliding[:, 1]),
            "friction": loop.regulator.learned_friction,
            "slip_evidence": loop.regulator.slip_likelihood,
            "grip": loop.regulator.state,
            "grasp_force": loop.regulator.grasp_force,
        }
        if row % 20 == 5:
            for name, value in expected.items():
                np.testing.assert_array_equal(getattr(record, name)[row], value, err_msg=name)
            turn = Rotation.from_quat(record.object_quaternion[row]).as_matrix()
            np.testing.assert_allclose(turn, state.rotation, atol=1e-12)
            believed = Rotation.from_quat(record.auxiliary_quaternion[row]).as_matrix()
            np.testing.assert_allclose(believed, command.pose.orientation, atol=1e-12)
        loop.advance(command.torque)


def test_a_run_that_diverges_ends_with_the_drop():
    push = [{"start": 0.05, "force": [1000.0, 0.0, 0.0]}]
    record = run(ticks=60, changes={"plant.disturbances": push})
    assert 25 < len(record) < 60 and np.isfinite(record.object_position).all()
    assert 0.05 < dropped_at(record) < record.times[-1]


def test_a_run_that_diverges_while_it_is_held_is_dropped_at_its_last_tick(monkeypatch):
    loop, ticks = ClosedLoop(load_scenario("paper")), iter(range(7))
    drive = loop.plant.drive

    def diverging(torque_of):
        if next(ticks) == 6:
            raise DivergedError("too fast")
        return drive(torque_of)

    monkeypatch.setattr(loop.plant, "drive", diverging)
    record = loop.run(20)
    m = metrics(record, loop.scenario)
    assert (len(record), m.is_dropped, m.goal_reached) == (7, True, False)
    assert m.dropped_at_s == record.times[-1] == pytest.approx(0.012)


# Properties of the object that touch cannot measure.
HIDDEN = {
    "mass": {"plant.object.mass": 0.4},
    "inertia": {"plant.object.inertia": [0.002, 0.003, 0.004]},
    "friction": {"plant.object.friction": 0.05},
    "weight": {"gravity": [0.0, 0.0, -2.0]},
    "size behind the contacts": {"plant.object.size": [0.2604, 0.2604, 0.5]},
    "push": {"plant.disturbances": [{"force": [0.2, 0.0, 0.0]}]},
}


def replay(scenario, seen):
    """Return the torques of the controller blocks for recorded joints and touch."""
    regulator = SlipRegulator(scenario.slip_regulator)
    controller = Controller(scenario.manipulation_controller)
    chain = Chain(regulator, ForceOptimizer(scenario.force_optimizer, 3), controller)
    for wish in scenario.targets:
        chain.controller.targets.command(wish.target(), wish.stamp)
    contacts = map(Contacts.from_poses, seen.contact_positions, seen.contact_quaternions)
    joints = map(Joints, seen.theta, seen.rates, seen.torque)
    ticks = zip(seen.stamps.tolist(), joints, contacts, seen.forces, strict=True)
    return np.array([chain.answer(*tick).command.torque for tick in ticks])


@pytest.fixture(scope="module")
def plain():
    return run()


@pytest.mark.parametrize("changes", HIDDEN.values(), ids=HIDDEN)
def test_the_same_joints_and_touch_give_the_same_torques_whatever_is_held(plain, changes):
    """Joints and touch alone reproduce the run on the changed object, bit for bit.

    The blocks are built from the unchanged scenario. If the closed loop passed them any property of
    the object, they could not reproduce its torques.
    """
    seen = run(changes=changes)
    np.testing.assert_array_equal(replay(load_scenario("paper"), seen), seen.command)
    if "plant.object.size" not in changes:
        assert np.abs(plain.command - seen.command).max() > 1e-9  # the object had an effect
