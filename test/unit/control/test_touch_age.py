# SPDX-License-Identifier: Apache-2.0
"""The age of contact points is found from joints that move."""

import numpy as np
import pytest
from support.controllers import Bench
from support.plants import plant

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.grasp import carried_along
from tactile_hand_ros.control.sensing import LateTouch

HAND, START = plant().hand, plant().state.theta
LARGEST, ERROR, TICK = 0.03, 1e-4, 0.002  # s, rad, s
FRAMES = plant().state.contacts.rotations
NORMALS = FRAMES[:, :, 1]
OFFSET = np.array([[1.0, -2.0, 0.5], [0.0, 1.5, -1.0], [2.0, 0.0, 1.0]]) * 1e-3  # of the skin, m


def angles(time, speed):
    """Return joint angles, rad, and their rates, rad/s, of at most `speed`."""
    pace = np.linspace(5.0, 9.0, 9)  # rad/s
    return START + speed / pace * np.sin(pace * time), speed * np.cos(pace * time)


def found(true, *, speed=0.3, noise=0.0, age=0.0, samples=300):
    """Return the age found for contacts that are `true` s old."""
    watch, random = LateTouch(HAND), np.random.default_rng(4)
    watch.age = age
    for time in TICK * np.arange(samples):
        theta, rates = angles(time, speed)
        tips, before = HAND.fingertips(theta), HAND.fingertips(angles(time - true, speed)[0])
        measured = before.positions + HAND.radii[:, None] * NORMALS + OFFSET
        contacts = Contacts(measured + random.normal(0.0, noise, (3, 3)), FRAMES)
        seen = theta, rates, tips, contacts, np.ones(3, dtype=bool)
        watch.step(round(1e9 * time), *seen, TICK, LARGEST, ERROR)
    return watch.age


@pytest.mark.parametrize("true", [0.0, 0.004, 0.013, 0.03])
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_it_is_found_whatever_the_offset_of_the_skin(true, noise):
    assert found(true, noise=noise) == pytest.approx(true, abs=1e-3)


def test_it_is_never_negative_nor_above_the_largest():
    assert found(-0.01) == 0.0
    assert found(0.05) == LARGEST


def test_motions_that_show_nothing_beyond_the_error_of_the_angles_change_nothing():
    slow = 0.5 * ERROR / LARGEST
    assert found(0.0, speed=slow, age=0.01) == found(0.0, speed=0.0, age=0.01) == 0.01
    assert found(0.0, age=0.01) == 0.0


def test_noise_alone_shows_no_age():
    assert found(0.0, speed=3.0 * ERROR / LARGEST, noise=1e-3) < 1e-3


def touch(bench, time):
    """Return the contacts with an object that the moving fingers carry."""
    tips, there = HAND.fingertips(START), bench.contacts
    moved = angles(time, 0.3)[0] - START
    return Contacts(*carried_along(tips, there.positions, there.rotations, moved))


def follow(bench, ticks, age, missing=None):
    """Answer ticks with contacts of some age in s, without those of one finger; return torques."""
    torques = []
    for _ in range(ticks):
        time = 1e-9 * bench.stamp
        theta, rates = angles(time, 0.3)
        contacts = touch(bench, time - age)
        if missing is not None:
            contacts.positions[missing] = contacts.rotations[missing] = np.nan
        torques.append(bench.step(theta=theta, rates=rates, contacts=contacts).torque)
    return np.array(torques)


def test_the_law_takes_late_contacts_where_they_are_now():
    """Also between two ticks, and soon after a finger was lost."""
    late, fresh = Bench(), Bench()
    follow(late, 1, 0.0), follow(fresh, 1, 0.0)
    found, wanted = follow(late, 100, 0.005), follow(fresh, 100, 0.0)
    np.testing.assert_allclose(found[3:], wanted[3:], atol=5e-4)  # without: 4.4e-3 N m
    follow(late, 3, 0.005, missing=1), follow(fresh, 3, 0.0, missing=1)
    found, wanted = follow(late, 6, 0.005), follow(fresh, 6, 0.0)
    np.testing.assert_allclose(found[3:], wanted[3:], atol=5e-4)


def test_a_reset_forgets_the_age_and_time_may_go_back():
    bench, new = Bench(), Bench()
    follow(bench, 50, 0.006)
    bench.stamp -= 20_000_000
    assert np.isfinite(follow(bench, 20, 0.006)).all()
    bench.controller.reset()
    bench.stamp = new.stamp = 0
    np.testing.assert_array_equal(follow(bench, 30, 0.006), follow(new, 30, 0.006))
