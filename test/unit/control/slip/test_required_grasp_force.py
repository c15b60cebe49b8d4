# SPDX-License-Identifier: Apache-2.0
"""The required grasp force of a touched object: steady under noise, quick under load."""

import math

import numpy as np
import pytest

from tactile_hand_ros.control.loads import ReserveConfig, Split
from tactile_hand_ros.control.slip.grasp_force import RequiredGraspForce

MU = np.array([0.5, 0.5, 0.5])
OWN = np.array([0.4, 0.9, 0.6])
SHARES = np.array([0.5, 0.2, 0.3])
SHAPE = np.array([[0.0, 0.475, 0.0], [0.0, 0.475, 0.0], [0.0, 0.05, 0.0]])
WEIGHT = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
DT = 0.001
NO_RESERVE = ReserveConfig(floor=0.0, fraction=0.0)
UP = np.tile([0.0, 1.0, 0.0], (3, 1))


def parts(load, force):
    return Split(load, force, force[:, 1].sum(), 1.0)


def fresh():
    return RequiredGraspForce(NO_RESERVE, len(MU), 1.0)


def required(**reserve):
    return RequiredGraspForce(ReserveConfig(**reserve), 3, 1.0)


def step(need, parts, friction=MU, dt=DT, **values):
    """Return the answer to a tick when all of the friction may be used."""
    return need.step(parts, UP, friction, values.pop("usable", friction), dt, **values)


def follow(need, load, ticks, force=6.0, noise=0.0, seed=0):
    random = np.random.default_rng(seed)
    shake = noise * random.standard_normal((ticks, 3, 3))
    return [step(need, parts(load, force * SHAPE + shake[i]))[0] for i in range(ticks)]


def test_noise_on_a_light_finger_does_not_raise_it():
    """0.3 N with 10 mN of noise, with a load at that finger's limit."""
    load = WEIGHT.copy()
    load[2] = [0.0, 0.0, 0.1]
    needs = follow(fresh(), load, 2000, noise=0.01)[200:]
    assert np.ptp(needs) < 0.1 * np.mean(needs)


@pytest.mark.parametrize("finger", range(3))
@pytest.mark.parametrize("rate", [20.0, 2.0, -8.0])
@pytest.mark.parametrize("dt", [5e-4, 1e-3, 4e-3])
def test_what_will_be_there_after_the_lead_counts(finger, rate, dt):
    """10 ms ahead at any rate of the ticks, for a load that grows steadily along itself."""
    need, load, shape = fresh(), np.zeros((3, 3)), SHARES[:, None] * [0.0, 1.0, 0.0]
    for time in dt * np.arange(round(0.1 / dt)):
        load[finger] = (1.0 + rate * time) * np.array([0.6, 0.0, 0.8])
        needed, _ = step(need, parts(load, 6.0 * shape), OWN, dt if time else 0.0)
    ahead = 1.0 + rate * (time + 0.01)
    assert needed == pytest.approx(ahead / (SHARES[finger] * OWN[finger]), rel=1e-6)


def test_a_shape_is_followed_slowly():
    """After 10 ms of 1 ms ticks, with a time constant of 30 ms; a firmer sample has more weight."""
    need, load = fresh(), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    step(need, parts(load, 6.0 * SHARES[:, None] * [0.0, 1.0, 0.0]), OWN, 0.0)
    other = np.array([0.2, 0.3, 0.5])
    for _ in range(10):
        needed, _ = step(need, parts(load, 4.0 * other[:, None] * [0.0, 1.0, 0.0]), OWN)
    then = np.exp(-10.0 / 30.0)
    share = (4.0 * 0.2 * (1.0 - then) + 6.0 * 0.5 * then) / (4.0 * (1.0 - then) + 6.0 * then)
    assert needed == pytest.approx(1.0 / (0.4 * share))


def test_where_no_time_has_passed_forces_count_unfiltered():
    need = fresh()
    follow(need, 3.0 * WEIGHT, 20)
    needed, _ = step(need, parts(WEIGHT, 6.0 * SHAPE), dt=0.0)
    assert needed == pytest.approx(1.0 / (0.475 * 0.5))


def at_once(**reserve):
    """Return a need whose reserve is complete from the next sample on."""
    need = required(**{"fraction": 0.0, **reserve})
    step(need, parts(0.0 * WEIGHT, 6.0 * SHAPE), dt=1.0)
    return need


def test_with_a_reserve_every_load_within_its_radius_finds_the_grasp_force_ready():
    """Verified by brute force: loads on a sphere around the present one."""
    need = at_once(floor=1.5)
    shape = SHARES[:, None] * [0.0, 1.0, 0.0]
    bare, ready = step(need, parts(WEIGHT, 6.0 * shape), OWN, 0.0)
    random = np.random.default_rng(0)
    ways = random.standard_normal((4000, 3, 3))
    ways *= 0.5 / np.linalg.norm(ways, axis=2, keepdims=True)
    loads = (parts(WEIGHT + way, 6.0 * shape) for way in ways[:1000])
    smallest = max(step(fresh(), load, OWN, 0.0)[0] for load in loads)
    assert bare < smallest <= ready
    assert ready == pytest.approx(smallest, rel=0.02)


def test_the_usable_friction_is_for_measured_loads_and_not_for_the_reserve():
    load = parts(3.0 * WEIGHT, 6.0 * SHAPE)
    need = at_once(floor=0.03)
    needed, ready = step(need, load, 1.2 * MU, 0.0, usable=MU)
    assert needed == ready == pytest.approx(follow(fresh(), 3.0 * WEIGHT, 1)[-1])
    need = at_once(floor=3.0)
    with_margin = step(need, load, 1.2 * MU, 0.0, usable=MU)[1]
    assert with_margin == step(need, load, 1.2 * MU, 0.0)[1] > needed


def test_of_a_grasp_that_is_not_whole_only_the_load_is_followed():
    """The internal force of a lost contact would turn the shape against its load."""
    need, whole = fresh(), fresh()
    for each in (need, whole):
        follow(each, WEIGHT, 20)
    gone = 6.0 * SHAPE * [[1.0], [1.0], [0.0]]
    for _ in range(30):
        found = step(need, parts(2.0 * WEIGHT, gone), grasped=False)
        expected = step(whole, parts(2.0 * WEIGHT, 6.0 * SHAPE))
    assert found[0] == pytest.approx(expected[0], rel=1e-12)


def test_the_margin_of_load_is_the_larger_of_its_floor_and_a_fraction_of_the_recent_load():
    need = required(floor=0.6, fraction=0.5)
    load = np.array([[0.3, 0.0, 0.4], [0.0, 0.1, 0.0], [0.0, 0.0, 4.0]])
    step(need, parts(load, 6.0 * SHAPE), dt=0.0)
    np.testing.assert_allclose(need.reserve, [0.25, 0.2, 2.0])
    step(need, parts(0.0 * load, 6.0 * SHAPE), dt=2.0)
    np.testing.assert_allclose(need.reserve, [0.2, 0.2, 2.0 * math.exp(-0.4)])


CARRIED = WEIGHT + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])


def reserves(need, ticks, first=0):
    """Return needed and available force at each tick, shape (ticks, 2)."""
    now = parts(CARRIED, 6.0 * SHAPE)
    return np.array([step(need, now, dt=DT if first + i else 0.0) for i in range(ticks)])


def test_the_reserve_of_a_new_grasp_rises_over_its_time():
    """In equal steps, from zero to all of it, while the need itself applies immediately."""
    need = required(floor=3.0, fraction=0.0)
    needed, ready = reserves(need, 200).T
    full = reserves(at_once(floor=3.0), 200)[:, 1]
    np.testing.assert_array_equal(needed, reserves(fresh(), 200)[:, 0])
    np.testing.assert_allclose(ready[50:], full[50:], rtol=1e-12)
    assert ready[0] == needed[0] and full[0] > 2.0 * needed[0]
    radius = 0.5 * np.sqrt(1.0 + 1.0 / 0.25) * np.arange(50) / 50.0  # times mu: 1 N at each finger
    expected = np.maximum((1.0 + radius) / (0.475 * 0.5), (0.1 + radius) / (0.05 * 0.5))
    np.testing.assert_allclose(ready[:50], expected, rtol=1e-9)


def test_the_reserve_rises_again_with_the_next_grasp():
    need = at_once(floor=3.0)
    assert np.diff(reserves(need, 1, first=1)[0]) > 0.0
    need.lose()
    assert np.diff(reserves(need, 1)[0]) == 0.0
