# SPDX-License-Identifier: Apache-2.0
"""A run counts its ticks, ends, holds the joints, and restarts from the same state."""

import numpy as np
import pytest

from tactile_hand_ros.scenario.scenario import load_scenario
from tactile_hand_ros.simulation.plant_run import PlantRun

TORQUE = np.full(9, 0.5)


def config():
    return load_scenario("paper", {"duration": 0.01}).plant


def advance(run, ticks, torque=None):
    """Advance by ticks, each with a command for a torque if there is one; return the state."""
    for _ in range(ticks):
        if torque is not None:
            run.command(run.stamp, torque)
        run.advance()
    return run.state


@pytest.mark.parametrize(("rate", "duration", "ticks"), [(500.0, 0.01, 5), (100.0, 0.29, 29)])
def test_ticks_carry_the_stamps_of_their_times_until_the_nearest_to_the_end(rate, duration, ticks):
    """0.29 x 100 is a little less than 29 in floating point."""
    run = PlantRun(config().changed({"duration": duration, "rate": rate}))
    stamps = [run.stamp]
    while not run.is_last:
        run.advance()
        stamps.append(run.stamp)
    assert stamps == [round(1e9 / rate) * i for i in range(ticks + 1)]
    assert run.stamp == pytest.approx(1e9 * run.plant.time)


def test_without_commands_the_joints_are_held_where_they_are():
    run = PlantRun(config())
    advance(run, 4, TORQUE)
    advance(run, 3)  # the age limit
    assert not run.guard.reason
    run.advance()
    assert run.guard.reason and run.guard.held == 1
    at = advance(run, 200).theta
    advance(run, 200)
    assert run.guard.held == 401
    np.testing.assert_allclose(run.state.theta, at, atol=1e-6)


def test_a_refused_sender_moves_nothing_until_it_is_released():
    run = PlantRun(config())
    run.refused = "two senders"
    run.command(0, TORQUE)
    run.advance()
    assert run.guard.reason == "two senders"
    assert np.abs(run.state.joints.applied).max() < 0.1
    run.refused = ""
    advance(run, 1, TORQUE)
    assert not run.guard.reason


def test_a_reset_run_repeats_to_the_bit_and_keeps_a_live_friction():
    run = PlantRun(config())
    first = advance(run, 20, TORQUE).theta
    run.refused = "two senders"
    run.reset()
    assert run.stamp == 0 and not run.refused and not run.commanded and not run.guard.reason
    np.testing.assert_array_equal(advance(run, 20, TORQUE).theta, first)
    run.plant.configure(config().changed({"object.friction": 0.25}))
    assert (run.plant.friction == 0.25).all()
    run.reset()
    assert (run.plant.friction == 0.25).all()


def test_a_push_moves_the_object_until_it_is_not_renewed_and_a_live_mass_counts():
    free = config().changed({"object.position": (0.0, 0.0, 9.0), "object.mass": 0.2})
    run = PlantRun(free.changed({"duration": 0.0, "rate": 1000.0, "time_step": 0.001}))
    push = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])

    def speed_after(ticks):
        return advance(run, ticks).velocity[1]

    assert speed_after(10) == 0.0
    run.push(0, push)
    assert speed_after(1000) == pytest.approx(0.3 * 0.2 / 0.2)
    run.push(run.stamp - 150_000_000, push)  # has traveled for long
    assert speed_after(100) == pytest.approx(0.3 + 0.3 * 0.05 / 0.2)
    run.push(run.stamp + 10**12, push)  # from another clock: it does not last longer
    run.plant.friction[1] = 0.1  # as by `friction_changes`; only a new friction ends it
    run.plant.configure(run.plant.config.changed({"object.mass": 0.4}))
    assert run.plant.friction[1] == 0.1
    before = run.state.velocity[1]
    assert speed_after(1000) == pytest.approx(before + 0.3 * 0.2 / 0.4)
    run.push(0, push)
    run.reset()
    assert speed_after(10) == 0.0
