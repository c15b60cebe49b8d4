# SPDX-License-Identifier: Apache-2.0
"""A run counts its ticks, ends, holds the joints, and begins anew as if nothing had been."""

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.scenario import load_scenario
from tactile_hand_ros.simulation.plant import Plant
from tactile_hand_ros.simulation.plant_run import PlantRun


def config(**changes):
    return load_scenario("paper", {"duration": 0.01, **changes}).plant


def test_ticks_carry_the_stamps_of_their_times_until_the_end():
    run = PlantRun(config())
    stamps = [run.stamp]
    while not run.is_last:
        run.advance()
        stamps.append(run.stamp)
    assert stamps == [0, 2_000_000, 4_000_000, 6_000_000, 8_000_000, 10_000_000]
    assert run.stamp == pytest.approx(1e9 * run.plant.time)


def test_without_a_duration_no_tick_is_the_last():
    run = PlantRun(config().changed({"duration": 0.0}))
    run.advance()
    assert not run.is_last


def test_the_commanded_torque_acts_as_in_the_plant():
    run, plant = PlantRun(config()), Plant(config())
    torque = np.linspace(0.1, 0.9, plant.hand.joints)
    run.command(torque)
    run.advance()
    np.testing.assert_array_equal(run.state.theta, plant.advance(torque).theta)


def test_held_joints_stay_where_they_are_on_top_of_the_last_torque():
    free, held = PlantRun(config()), PlantRun(config())
    torque = np.full(free.plant.hand.joints, 0.5)
    for run in (free, held):
        run.command(torque)
        run.advance()
    held.hold()
    at = held.state.theta
    np.testing.assert_allclose(held.state.torque, torque)
    for _ in range(200):
        free.advance()
        held.advance()
    assert held.holding and held.held == 200 and free.held == 0
    moved, kept = np.abs(free.state.theta - at).max(), np.abs(held.state.theta - at).max()
    assert kept < 0.3 * moved
    held.command(torque)
    assert not held.holding


def test_a_reset_run_repeats_to_the_bit_and_keeps_a_live_friction():
    run = PlantRun(config())
    torque = np.full(run.plant.hand.joints, 0.5)

    def end():
        run.command(torque)
        for _ in range(20):
            run.advance()
        return run.state.theta

    first = end()
    run.hold()
    run.reset()
    assert run.stamp == 0 and not run.holding and not run.commanded
    np.testing.assert_array_equal(end(), first)
    run.configure(config().changed({"object.friction": 0.25}))
    assert (run.plant.friction == 0.25).all()
    run.reset()
    assert (run.plant.friction == 0.25).all()
