# SPDX-License-Identifier: Apache-2.0
"""Forces split into load and internal force, cones, the k_f that holds, and observed loads."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.grasps import FORCES, balance_in_frames, grasps, moved, three_faces

from tactile_hand_ros.control.contact import Contacts, in_palm
from tactile_hand_ros.control.grasp import collinearity_margin
from tactile_hand_ros.control.loads import (
    CarriedLoad,
    LoadObserver,
    ObserverConfig,
    required_grasp_force,
    split,
)
from tactile_hand_ros.control.optimizer.cones import INSIDE, Cones, grasp_frames, reaches
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.rotations import rotation_from_vector

MS = 1_000_000
GRASP = moved(three_faces(), rotation_from_vector([0.4, -1.1, 0.7]), np.array([0.1, -0.2, 0.3]))
MU = np.array([0.5, 0.3, 0.8])
LIGHT = CarriedLoad(
    np.array([[0.2, 0.1, 0.3], [-0.1, 0.0, 0.2], [0.1, 0.0, -0.1]]), MU, np.array([0.1, 0.2, 0.3])
)
HEAVY = LIGHT._replace(load=np.array([[0.5, 0.2, -0.1], [0.1, 0.0, 0.5], [-0.2, 0.2, 0.1]]))


@given(grasps(), st.integers(0, 2**32 - 1))
def test_the_load_is_the_smallest_with_the_net_wrench_and_the_grasp_force_balances(contacts, seed):
    forces = np.random.default_rng(seed).normal(size=contacts.positions.shape)
    pressing, balance = in_palm(contacts.rotations, forces, 1.0), balance_in_frames(contacts)
    parts = split(contacts.positions, contacts.normals, pressing)
    load, internal = (np.einsum("kji,kj->ki", contacts.rotations, x) for x in parts[:2])
    expected = np.linalg.pinv(balance) @ balance @ forces.ravel()
    np.testing.assert_allclose(load.ravel(), expected, atol=1e-9)
    np.testing.assert_allclose(load + internal, forces, atol=1e-12)
    np.testing.assert_allclose(balance @ internal.ravel(), np.zeros(6), atol=1e-9)
    assert parts.grasp_force == pytest.approx(internal[:, 1].sum())
    assert parts.margin == pytest.approx(collinearity_margin(contacts.positions))


def needed(load, shape, friction, turn=(0.5, -0.3, 1.1)):
    """Return the force that holds a contact whose frame (x, n, z) is rotated."""
    frame = rotation_from_vector(turn)
    return required_grasp_force(frame @ load, frame @ shape, frame[:, 1].copy(), friction)


@pytest.mark.parametrize(
    ("load", "shape", "friction", "expected"),
    [
        ((3.0, 0.0, 4.0), (0.0, 0.5, 0.0), 0.4, 25.0),  # 5 N sideways over 0.4 times a half
        ((0.0, -2.0, 0.0), (0.0, 0.5, 0.0), 0.4, 4.0),  # a pulling one must be overcome first
        ((0.3, 1.0, 0.2), (0.0, 0.5, 0.0), 0.4, 0.0),  # inside already
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.4, 0.0),  # nothing to hold
        ((1.0, 0.0, 0.0), (0.1, 0.5, 0.0), 0.4, 10.0),  # 1 + 0.1 k = 0.2 k
        ((1.0, 0.0, 0.0), (-0.6, 0.5, 0.0), 0.4, 1.25),  # crosses the cone: 1 - 0.6 k = 0.2 k
        ((1.0, 0.0, 0.5), (-0.6, 0.5, 0.0), 0.4, math.inf),  # misses the cone
        ((1.0, 1.0, 0.0), (0.0, -0.5, 0.0), 0.4, math.inf),  # pulls
        ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.4, math.inf),
    ],
)
def test_the_grasp_force_that_holds_a_load_has_the_values_computed_by_hand(
    load, shape, friction, expected
):
    assert needed(load, shape, friction) == pytest.approx(expected)


@given(st.floats(0.01, 9.0), st.floats(0.01, 1.0), st.floats(0.05, 1.5))
def test_a_contact_that_is_pulled_straight_off_needs_just_that_much(pull, share, friction):
    """The root is a double one, and must survive rounding."""
    found = needed((0.0, -pull, 0.0), (0.0, share, 0.0), friction)
    assert found == pytest.approx(pull / share, rel=1e-5)


@given(
    st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.floats(0.05, 1.5),
)
def test_the_required_grasp_force_is_the_minimum_that_holds(load, shape, friction):
    """The distance to the cone is concave in k: the contact holds on one interval or never."""
    load, shape = np.array(load), np.array(shape)
    assume(abs(shape[0] ** 2 + shape[2] ** 2 - friction**2 * shape[1] ** 2) > 1e-2)

    def inside(k):
        x, n, z = (load[:, None] + shape[:, None] * k) if np.ndim(k) else load + k * shape
        return friction * n - np.hypot(x, z)

    k = needed(load, shape, friction)
    if math.isinf(k):
        assert inside(np.geomspace(1e-3, 1e4, 2000)).max() < 1e-9 and inside(0.0) < 1e-9
    elif k < 1e-9:
        assert inside(k) >= -1e-9
    else:
        # Where the force only touches the cone or its apex, k is a double root, known to some
        # sqrt(eps) = 1.5e-8.
        assert inside(k) == pytest.approx(0.0, abs=1e-7 * (1.0 + k))
        assert inside(np.linspace(0.0, 0.999 * k, 100)).max() < 1e-9


def made(steps, **values):
    """Return f* after ticks given by timestamp in ms, load and grasp force."""
    optimizer = ForceOptimizer(ForceOptimizerConfig(cones=True, shape_time=0.0, **values), 3)
    for at, carried, grasp_force in steps:
        found = optimizer.step(at * MS, GRASP, carried, grasp_force)
    return found


def by_hand(beyond, carried, grasp_force):
    """Return f* for forces beyond the pyramids, and the reserve, at 3/4 of a grasp force."""
    radii = carried.reserve * np.sqrt(1.0 + carried.friction**2)
    wanted = (beyond + INSIDE * radii[:, None]) / (0.75 * grasp_force)
    frames, _ = grasp_frames(GRASP.positions, GRASP.rotations)
    load = turned(frames, carried.load) / grasp_force
    found = ForceOptimizer(ForceOptimizerConfig(shape_time=0.0), 3).solve(
        Contacts(GRASP.positions, frames), Cones(carried.friction, load, 0.0, wanted)
    )
    return turned(GRASP.rotations, found.forces, frames), found.cone_margin


def turned(frames, forces, given=GRASP.rotations):
    """Return forces of some frames in others."""
    return np.einsum("kji,kjl,kl->ki", frames, given, forces)


def beyond(carried):
    frames, _ = grasp_frames(GRASP.positions, GRASP.rotations)
    return reaches(turned(frames, carried.load), carried.friction)


@pytest.mark.parametrize("grasp_force", [3.0, 6.0])
def test_f_is_made_for_less_grasp_force_than_there_is_and_for_a_reserve(grasp_force):
    found = made([(7, LIGHT, grasp_force)])
    forces, margin = by_hand(beyond(LIGHT), LIGHT, grasp_force)
    assert found.shaped
    np.testing.assert_allclose(found.forces, forces, atol=1e-9)
    assert found.cone_margin == pytest.approx(margin, abs=1e-9)


def test_f_is_made_for_the_worst_of_the_recent_past_and_forgets_it():
    """For each side of the pyramids the larger one, which decays to the present one."""
    one, two = beyond(HEAVY), beyond(LIGHT)
    worst = np.maximum(two, two + math.exp(-0.5) * (one - two))
    assert (worst > two + 0.05).any() and (worst == two).any()
    found = made([(0, HEAVY, 6.0), (500, LIGHT, 6.0)], load_memory=1.0)
    np.testing.assert_allclose(found.forces, by_hand(worst, LIGHT, 6.0)[0], atol=1e-9)


NOTHING = LIGHT._replace(load=np.full((3, 3), np.nan))


@pytest.mark.parametrize(
    "missing", [None, NOTHING, LIGHT._replace(load=np.where(np.eye(3) > 0, np.nan, 0.1))]
)
def test_without_a_load_the_optimizer_leaves_out_the_cones(missing):
    found = made([(0, missing, 5.0)])
    assert found.ok and not found.shaped and math.isnan(found.cone_margin)


@pytest.mark.parametrize(
    "happens",
    [
        lambda o: o.reset(),
        lambda o: o.step(4 * MS, GRASP, NOTHING, 5.0),
        lambda o: o.step(4 * MS, GRASP.without(np.arange(3) == 1), HEAVY, 5.0),
    ],
    ids=["reset", "no load", "a lost contact"],
)
def test_after_an_interruption_the_loads_before_it_are_forgotten(happens):
    optimizer = ForceOptimizer(ForceOptimizerConfig(cones=True), 3)
    optimizer.step(3 * MS, GRASP, HEAVY, 5.0)
    happens(optimizer)
    found = optimizer.step(5 * MS, GRASP, LIGHT, 5.0)
    np.testing.assert_allclose(found.forces, made([(0, LIGHT, 5.0)]).forces, atol=1e-9)


TIME, DT = 0.05, 0.002
UNLIMITED = {"force_limit": 1e3, "torque_limit": 1e3}
NET = balance_in_frames(GRASP) @ FORCES.ravel()  # of the grasp, about its centroid


def settled(config):
    """Return an observer after a hundred time constants with constant forces."""
    observer = LoadObserver()
    observer.step(config, GRASP, FORCES, 100.0 * config.time)
    return observer


def test_a_step_is_met_as_by_a_low_pass():
    """After n ticks it has 1 - exp(-n dt / T) of the step, for any tick length."""
    config = ObserverConfig(time=TIME, **UNLIMITED)
    for ticks, dt in ((1, DT), (25, DT), (200, DT), (10, 0.005), (1, TIME)):
        observer = LoadObserver()
        for _ in range(ticks):
            carried = observer.step(config, GRASP, FORCES, dt)
        share = 1.0 - math.exp(-ticks * dt / TIME)
        np.testing.assert_allclose(carried, share * NET, rtol=1e-12)
    first = carried.copy()
    np.testing.assert_array_equal(observer.step(config, GRASP, 3.0 * FORCES, 0.0), first)
    second = observer.step(config, GRASP, -2.0 * FORCES, TIME)
    np.testing.assert_allclose(second, math.exp(-1.0) * first - 2.0 * share * NET, rtol=1e-12)


@pytest.mark.parametrize(("part", "name"), [(slice(0, 3), "force"), (slice(3, 6), "torque")])
def test_force_and_torque_are_limited_each_for_itself_in_length_not_in_direction(part, name):
    limit, expected = 0.7 * np.linalg.norm(NET[part]), NET.copy()
    config = ObserverConfig(time=TIME, **{**UNLIMITED, f"{name}_limit": limit})
    expected[part] *= 0.7
    np.testing.assert_allclose(settled(config).wrench, expected, rtol=1e-12)


def test_the_limited_load_does_not_wind_up():
    config = ObserverConfig(time=TIME, force_limit=0.5, torque_limit=0.01)
    observer = LoadObserver()
    for _ in range(1000):
        carried = observer.step(config, GRASP, FORCES, DT)
    full = carried.copy()
    lengths = np.linalg.norm(full.reshape(2, 3), axis=1)
    np.testing.assert_allclose(lengths, [0.5, 0.01], rtol=1e-12)
    gone = observer.step(config, GRASP, np.zeros((3, 3)), DT)
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
        np.testing.assert_array_equal(observer.step(config, GRASP, lost, DT), before)
    positions = GRASP.positions.copy()
    positions[2] = value
    apart = Contacts(positions, GRASP.rotations)  # a lost point, though its force is known
    np.testing.assert_array_equal(observer.step(config, apart, 2.0 * FORCES, DT), before)
    doubled = observer.step(config, GRASP, 2.0 * FORCES, DT)
    np.testing.assert_allclose(doubled, (2.0 - math.exp(-DT / TIME)) * before, rtol=1e-12)
