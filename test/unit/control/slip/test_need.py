# SPDX-License-Identifier: Apache-2.0
"""The squeeze that a touched object needs: steady under noise, quick under load."""

import numpy as np
import pytest

from tactile_hand_ros.control.slip.need import Need, NeedConfig
from tactile_hand_ros.control.slip.split import Split

MU = np.array([0.5, 0.5, 0.5])
SHAPE = np.array([[0.0, 0.475, 0.0], [0.0, 0.475, 0.0], [0.0, 0.05, 0.0]])
WEIGHT = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
DT = 0.001


def felt(load, squeeze):
    return Split(load, squeeze, squeeze[:, 1].sum())


def fresh():
    return Need(NeedConfig(), len(MU))


def follow(need, load, ticks, squeeze=6.0, noise=0.0, seed=0):
    random = np.random.default_rng(seed)
    shake = noise * random.standard_normal((ticks, 3, 3))
    return [need.step(felt(load, squeeze * SHAPE + shake[i]), MU, DT) for i in range(ticks)]


def test_it_is_the_load_over_share_and_friction():
    assert follow(fresh(), WEIGHT, 10)[-1] == pytest.approx(1.0 / (0.475 * 0.5))


def test_noise_on_a_light_finger_does_not_raise_it():
    """0.3 N with 10 mN of noise, with a load at the edge of what that finger can bear."""
    load = WEIGHT.copy()
    load[2] = [0.0, 0.0, 0.1]
    needs = follow(fresh(), load, 2000, noise=0.01)[200:]
    assert np.ptp(needs) < 0.1 * np.mean(needs)


def test_a_load_that_grows_is_foreseen():
    """20 N/s: what will be there in 10 ms counts."""
    need = fresh()
    follow(need, WEIGHT, 100)
    for i in range(50):
        parts = felt(WEIGHT * (1.0 + 0.02 * i), 6.0 * SHAPE)
        needed = need.step(parts, MU, DT)
    now = (1.0 + 0.02 * 49) / (0.475 * 0.5)
    assert now < needed < 1.2 * now


def test_a_shape_outside_its_cone_is_no_help():
    load = WEIGHT.copy()
    outside = SHAPE + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.04, 0.0, 0.0]])
    load[2] = [0.5, 0.0, 0.0]
    assert np.isinf(fresh().step(felt(load, 6.0 * outside), MU, 0.0))


def test_reset_forgets():
    need = fresh()
    follow(need, 3.0 * WEIGHT, 100)
    need.reset()
    assert follow(need, WEIGHT, 1)[-1] == pytest.approx(1.0 / (0.475 * 0.5))
