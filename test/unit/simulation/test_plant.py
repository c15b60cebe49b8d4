# SPDX-License-Identifier: Apache-2.0
"""The plant without contact: free bodies, pushes, energy, limits, and rejected input."""

from unittest.mock import Mock

import numpy as np
import pytest
from support.hands import posture_for, write_hand
from support.plants import after, energy_of, momentum, plant

from tactile_hand_ros.errors import ConfigurationError, DivergedError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation import plant as plant_module
from tactile_hand_ros.simulation.contact_step import TOUCH
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_config import (
    Disturbance,
    FrictionChange,
    PlantConfig,
    external_wrench,
)

FAR = {"object__position": (0.0, 0.0, 9.0), "object__mass": 0.2}
UNEQUAL = (0.001, 0.002, 0.0028)


def push(**values):
    return Disturbance(kind="pulse", duration=0.1, **values)


def test_a_free_object_falls_as_galilei_found():
    world = plant(gravity=(1.0, 0.0, -9.81), **FAR)
    state = after(world, 500)
    np.testing.assert_allclose(state.velocity, [0.5, 0.0, -4.905], atol=1e-12)
    np.testing.assert_allclose(state.position, [0.125, 0.0, 9.0 - 1.22625], atol=1e-12)
    assert not state.contacts.touching.any() and not state.forces.any()
    assert world.time == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("shape", "factors"),
    [
        ({"kind": "step"}, [0.0, 1.0, 1.0, 1.0]),
        ({"kind": "ramp", "duration": 0.25}, [0.0, 0.0, 0.8, 1.0]),
        ({"kind": "pulse", "duration": 0.25}, [0.0, 1.0, 1.0, 0.0]),
        ({"kind": "sine", "duration": 0.24, "frequency": 1.25}, [0.0, 0.0, 1.0, 0.0]),
    ],
)
def test_a_push_starts_and_ends_and_adds_to_others(shape, factors):
    pushes = [
        Disturbance(force=(1.0, 0.0, 0.0)),
        Disturbance(start=1.0, force=(1.0, 2.0, 0.0), torque=(0.0, 0.0, 3.0), **shape),
    ]
    for time, factor in zip([0.999, 1.0, 1.2, 1.25], factors, strict=True):
        expected = [1.0 + factor, 2.0 * factor, 0.0, 0.0, 0.0, 3.0 * factor]
        np.testing.assert_allclose(external_wrench(pushes, time), expected, atol=1e-12)


def test_a_push_counts_in_the_middle_of_each_step():
    ramp = Disturbance(kind="ramp", duration=0.1, force=(0.4, 0.0, 0.0))
    state = after(plant(disturbances=[ramp], **FAR), 100)
    assert state.velocity[0] == pytest.approx(0.5 * 0.4 * 0.1 / 0.2, rel=1e-12)


def spinning(step):
    """Return an asymmetric body that has been spun up about all axes and then moves freely."""
    twist = push(torque=(0.01, 0.12, 0.02), force=(0.1, 0.0, 0.0))
    world = plant(step, disturbances=[twist], object__inertia=UNEQUAL, **FAR)
    after(world, round(0.1 / step))
    return world


def drift_of_spin(step):
    world = spinning(step)
    energy, (_, before) = energy_of(world), momentum(world, world.state)
    state = after(world, round(0.5 / step))
    lost = np.abs(momentum(world, state)[1] - before).max() / np.linalg.norm(before)
    return lost, abs(energy_of(world) / energy - 1.0)


def test_a_tumbling_body_keeps_angular_momentum_and_energy():
    """Without torque both are constant while the spin changes, to second order."""
    coarse, fine = np.array(drift_of_spin(0.002)), np.array(drift_of_spin(0.001))
    assert (fine < 5e-5).all()
    assert (fine < 0.3 * coarse).all()
    world = spinning(0.001)
    before = world.state.spin
    assert np.abs(after(world, 200).spin - before).max() > 0.05 * np.linalg.norm(before)


def test_torque_is_limited_as_by_a_motor():
    world = plant(**FAR)
    given = np.array([100.0, -100.0, 20.0, -20.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    state = world.advance(given)
    np.testing.assert_array_equal(state.joints.applied, [20.0, -20.0, 20.0, -20.0, 3.0, 0, 0, 0, 0])
    limited = plant(**FAR).advance(np.clip(given, -20.0, 20.0))
    np.testing.assert_array_equal(state.rates, limited.rates)


def test_a_tick_is_made_of_whole_steps():
    """Two steps of 1 ms in a tick of 500 Hz are two ticks of 1 kHz."""
    torque = np.linspace(-1.0, 1.0, 9)
    tick = plant(rate=500.0, **FAR).advance(torque)
    single = plant(**FAR)
    single.advance(torque)
    np.testing.assert_allclose(tick.theta, single.advance(torque).theta, atol=1e-14)
    assert PlantConfig(rate=500.0).tick == 2_000_000
    for rate, step in ((300.0, 0.001), (3000.0, 0.001), (700.0, 0.002)):
        with pytest.raises(ConfigurationError, match="expected a whole number"):
            PlantConfig().changed({"rate": rate, "time_step": step})


def test_a_reset_starts_the_same_motion_again_and_changes_no_state_of_before():
    changes = [FrictionChange(start=0.04, friction=0.5), FrictionChange(start=0.02, friction=0.1)]
    friction = {"friction_changes": changes, "object__friction": 0.3}
    blow = push(start=0.01, force=(1.0, 2.0, 3.0), torque=(0.01, 0, 0))
    world = plant(gravity=(0.0, 0.0, -1.0), disturbances=[blow], **friction)

    def motion():
        frictions.append([])
        for torque in np.random.default_rng(0).standard_normal((60, 9)):
            yield world.advance(torque)
            frictions[-1].append(set(world.friction))

    frictions = []
    first = list(motion())
    back = world.reset()
    assert world.time == 0.0 and not back.rates.any() and not back.forces.any()
    for again, before in zip(motion(), first, strict=True):
        for name in ("theta", "rates", "position", "rotation", "spin", "forces", "sliding", "slid"):
            np.testing.assert_array_equal(getattr(again, name), getattr(before, name))
    assert frictions[0] == frictions[1] == [{0.3}] * 20 + [{0.1}] * 20 + [{0.5}] * 20


@pytest.mark.parametrize("layout", ["three_faces", "pinch"])
def test_the_paper_starts_with_all_fingers_just_touching(layout):
    world = plant(layout=layout)
    state = world.state
    assert state.contacts.touching.all()
    np.testing.assert_allclose(state.gaps, 0.0, atol=1e-12)
    np.testing.assert_allclose(state.theta.reshape(3, 3), [[1.047, 0.0, 1.571]] * 3, atol=1e-3)
    on_object = state.contacts.positions - [0.0, 0.0, 0.4098]
    np.testing.assert_allclose(np.abs(on_object).max(axis=1), 0.1302, atol=1e-12)
    assert not state.forces.any() and not state.rates.any()


def test_small_gaps_are_closed_and_large_ones_left():
    near = plant(object__size=(0.2570, 0.2570, 0.2570))
    assert near.state.contacts.touching.all() and near.state.gaps.max() <= TOUCH
    far = plant(object__size=(0.24, 0.2604, 0.2604)).state
    np.testing.assert_array_equal(far.contacts.touching, [False, False, True])
    np.testing.assert_allclose(far.gaps[:2], 0.0102, atol=1e-3)
    assert np.isnan(far.contacts.positions[0]).all() and np.isnan(far.contacts.rotations[0]).all()


def test_fingers_that_bend_in_a_plane_close_a_gap_beside_it(tmp_path):
    """Two joints move a tip along a normal that is 69 degrees off their plane."""
    path = write_hand(tmp_path, [2, 2])
    tips = np.array([[0.0215, 0.0, 0.35], [-0.0215, 0.0, 0.35]])
    theta = posture_for(Hand.load(str(path)), tips)
    middle = np.array([0.0, 0.056, 0.35])
    radius = np.linalg.norm(tips[0] - middle) - 0.02 - 3e-4
    ball = {"shape": "sphere", "size": [2.0 * radius] * 3, "position": middle.tolist()}
    ball = {f"object__{name}": value for name, value in ball.items()}
    made = plant(hand=str(path), layout="", initial_joints=theta.tolist(), **ball)
    assert made.state.contacts.all_touching and np.abs(made.state.gaps).max() < 1e-9
    assert np.abs(made.state.theta - theta).max() > 1e-3


@pytest.mark.parametrize("angles", [[1.0], [1.0] * 6, []])
def test_a_wrong_number_of_initial_angles_is_refused(angles):
    with pytest.raises(ConfigurationError, match=r"expected 9.*or 3 for every finger"):
        plant(initial_joints=angles)


def test_a_simulation_that_diverges_reports_it_and_can_restart():
    made = plant(disturbances=[push(start=0.1, force=(0.0, 0.0, 1e7))])
    with pytest.raises(DivergedError, match="has diverged at .* s.* reset the plant"):
        after(made, 2000)
    made.reset()
    assert np.isfinite(after(made, 1).theta).all()


def test_a_step_with_a_joint_at_its_stop_runs_the_code_of_every_other_step(monkeypatch):
    """The code is compiled for one array order; another would cost many seconds."""
    step = Mock(wraps=plant_module.step)
    monkeypatch.setattr(plant_module, "step", step)
    world = plant(initial_joints=[3.14, 0.0, 1.5], **FAR)
    world.hand.position_limits[1][:] = world.state.theta
    world.advance(np.ones(9))
    orders = [call.args[4].inertia.flags.c_contiguous for call in step.call_args_list]
    assert len(orders) > 1 and all(orders)


def test_a_joint_stops_at_its_limit_without_energy_and_leaves_it_freely():
    """Each joint is driven to a limit, rests there, and returns as if there were none."""
    world = plant(hand="human", initial_joints=[0.5, 0.1, 0.8], **FAR)
    lower, upper = world.hand.position_limits
    torque = np.tile([0.02, -0.02, 0.02], 3)
    state, energy, gained = world.state, energy_of(world), []
    for _ in range(round(0.6 * world.config.rate)):
        before, start = energy, state.theta
        state = world.advance(torque)
        energy, work = energy_of(world), torque @ (state.theta - start)
        gained.append((energy - before - work) / (before + 1e-9))
        assert (state.theta < upper + 1e-9).all() and (state.theta > lower - 1e-9).all()
    assert max(gained[5:]) < 5e-3 and min(gained) < -0.05  # per step, and at a stop
    stopped = np.where(torque > 0.0, upper, lower)
    np.testing.assert_allclose(state.theta, stopped, atol=2e-3)
    np.testing.assert_allclose(state.rates, 0.0, atol=1e-6)
    away = world.advance(-torque)
    inertia = world.hand.dynamics(state.theta, state.rates)[1]
    expected = np.linalg.solve(inertia, -torque) / world.config.rate
    np.testing.assert_allclose(away.rates, expected, rtol=0.02)


def test_an_object_presses_on_a_finger_at_its_stop_as_on_a_wall():
    """The contact laws hold, and the stop carries the load of the finger."""
    scenario = load_scenario("human_hold")
    world = Plant(scenario.plant)
    state = world.state
    _, upper = world.hand.position_limits
    upper[:] = np.minimum(upper, state.theta)  # joints can only open from here
    closing = np.tile([0.2, 0.0, 0.2], 3)
    for _ in range(100):
        state = world.advance(closing)
        assert world.contact_residual < 1e-6 and (state.theta <= upper + 1e-9).all()
    assert np.abs(state.rates).max() < 1e-6
