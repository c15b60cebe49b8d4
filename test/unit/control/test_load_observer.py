# SPDX-License-Identifier: Apache-2.0
"""The load observer: a low-pass of the net contact force, limited, ignoring lost forces."""

import math

import numpy as np
import pytest
from support.equations import grasp_map
from support.grasps import contacts_at

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.loads import LoadObserver, ObserverConfig

DT, TIME = 0.002, 0.05
GRIP = contacts_at(
    [[0.13, 0.01, 0.40], [-0.11, -0.03, 0.43], [0.02, 0.12, 0.38]],
    [[-1.0, 0.2, 0.1], [0.9, 0.3, -0.2], [0.1, -1.0, 0.3]],
)
FORCES = np.array([[0.3, 4.0, -0.2], [0.1, 2.5, 0.6], [-0.4, 3.0, 0.5]])
UNLIMITED = {"force_limit": 1e3, "torque_limit": 1e3}


def net(forces=FORCES):
    """Return the wrench of forces in contact frames about the centroid of the grip."""
    in_palm = [r @ f for r, f in zip(GRIP.rotations, forces, strict=True)]
    about = grasp_map(GRIP.positions, GRIP.positions.mean(axis=0))
    return about @ np.concatenate(in_palm)


def settled(config):
    """Return an observer after a hundred time constants with constant forces."""
    observer = LoadObserver()
    observer.step(config, GRIP, FORCES, 100.0 * config.time)
    return observer


def test_a_step_is_met_as_by_a_low_pass():
    """After n ticks it has 1 - exp(-n dt / T) of the step, for any tick length."""
    config = ObserverConfig(time=TIME, **UNLIMITED)
    for ticks, dt in ((1, DT), (25, DT), (200, DT), (10, 0.005), (1, TIME)):
        observer = LoadObserver()
        for _ in range(ticks):
            carried = observer.step(config, GRIP, FORCES, dt)
        share = 1.0 - math.exp(-ticks * dt / TIME)
        np.testing.assert_allclose(carried, share * net(), rtol=1e-12)
    first = carried.copy()
    np.testing.assert_array_equal(observer.step(config, GRIP, 3.0 * FORCES, 0.0), first)
    second = observer.step(config, GRIP, -2.0 * FORCES, TIME)
    np.testing.assert_allclose(second, math.exp(-1.0) * first - 2.0 * share * net(), rtol=1e-12)


@pytest.mark.parametrize(("part", "name"), [(slice(0, 3), "force"), (slice(3, 6), "torque")])
def test_force_and_torque_are_limited_each_for_itself_in_length_not_in_direction(part, name):
    full = net()
    limit = 0.7 * np.linalg.norm(full[part])
    config = ObserverConfig(time=TIME, **{**UNLIMITED, f"{name}_limit": limit})
    expected = full.copy()
    expected[part] *= 0.7
    np.testing.assert_allclose(settled(config).wrench, expected, rtol=1e-12)


def test_the_limited_load_does_not_wind_up():
    config = ObserverConfig(time=TIME, force_limit=0.5, torque_limit=0.01)
    observer = LoadObserver()
    for _ in range(1000):
        carried = observer.step(config, GRIP, FORCES, DT)
    full = carried.copy()
    np.testing.assert_allclose(
        [np.linalg.norm(full[:3]), np.linalg.norm(full[3:])], [0.5, 0.01], rtol=1e-12
    )
    gone = observer.step(config, GRIP, np.zeros((3, 3)), DT)
    np.testing.assert_allclose(gone, math.exp(-DT / TIME) * full, rtol=1e-12)
    np.testing.assert_array_equal(carried, full)  # what was handed out does not change later


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_lost_forces_keep_the_load_until_they_return(value):
    config = ObserverConfig(time=TIME, **UNLIMITED)
    observer = settled(config)
    before = observer.wrench.copy()
    lost = FORCES.copy()
    lost[1, 2] = value
    for _ in range(3):
        np.testing.assert_array_equal(observer.step(config, GRIP, lost, DT), before)
    positions = GRIP.positions.copy()
    positions[2] = value
    apart = Contacts(positions, GRIP.rotations)  # a lost point, though its force is known
    np.testing.assert_array_equal(observer.step(config, apart, 2.0 * FORCES, DT), before)
    doubled = observer.step(config, GRIP, 2.0 * FORCES, DT)
    np.testing.assert_allclose(doubled, (2.0 - math.exp(-DT / TIME)) * before, rtol=1e-12)
