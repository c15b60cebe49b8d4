# SPDX-License-Identifier: Apache-2.0
"""Forces as load and internal force, what the cones get of them, and the k_f that holds."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.grasps import balance_in_frames, contacts_at, grasps, moved, three_faces

from tactile_hand_ros.control.contact import Contacts, in_palm
from tactile_hand_ros.control.grasp import collinearity_margin
from tactile_hand_ros.control.loads import LoadMargin, LoadMarginConfig, required_grasp_force, split
from tactile_hand_ros.control.optimizer.cones import ConeTracker, cone_margin, reaches
from tactile_hand_ros.control.optimizer.force_optimizer import ForceOptimizer, ForceOptimizerConfig
from tactile_hand_ros.rotations import rotation_from_vector

MS = 1_000_000
GRASP = moved(three_faces(), rotation_from_vector([0.4, -1.1, 0.7]), np.array([0.1, -0.2, 0.3]))
FORCES = np.array([[0.3, 3.0, 0.9], [-0.2, 2.5, 0.6], [0.1, 0.8, -0.1]])
HEAVY = FORCES + np.array([[0.9, 0.1, -0.4], [0.2, 0.0, 0.7], [-0.3, 0.2, 0.5]])
MU = np.array([0.5, 0.3, 0.8])


def cone_watch(**values):
    config = ForceOptimizerConfig(load_time=0.02, squeeze_share=0.7, **values)
    return ConeTracker(config, 3, 1.0)


def thin(margin):
    """Return contacts nearly on a line; of a height h over it h / sqrt(3) is the margin."""
    height = margin * math.sqrt(3.0)
    points = 0.1 * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, height, 0.0]])
    return contacts_at(points, [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])


def per_grasp_force(contacts, forces):
    """Return the load per grasp force by the pseudoinverse of G~ in contact frames."""
    balance = balance_in_frames(contacts)
    load = (np.linalg.pinv(balance) @ balance @ forces.ravel()).reshape(-1, 3)
    return load / (forces - load)[:, 1].sum()


def parts_of(contacts, forces):
    """Split forces that are given in contact frames."""
    return split(contacts.positions, contacts.normals, in_palm(contacts.rotations, forces, 1.0))


@given(grasps(), st.integers(0, 2**32 - 1))
def test_the_load_is_the_smallest_with_the_net_wrench_and_the_grasp_force_balances(contacts, seed):
    forces = np.random.default_rng(seed).normal(size=contacts.positions.shape)
    parts, balance = parts_of(contacts, forces), balance_in_frames(contacts)
    load, internal = (np.einsum("kji,kj->ki", contacts.rotations, x) for x in parts[:2])
    expected = np.linalg.pinv(balance) @ balance @ forces.ravel()
    np.testing.assert_allclose(load.ravel(), expected, atol=1e-9)
    np.testing.assert_allclose(load + internal, forces, atol=1e-12)
    np.testing.assert_allclose(balance @ internal.ravel(), np.zeros(6), atol=1e-9)
    assert parts.grasp_force == pytest.approx(internal[:, 1].sum())
    assert parts.margin == pytest.approx(collinearity_margin(contacts.positions))


def test_the_cones_are_told_the_load_per_newton_and_the_friction_of_each_finger():
    cones = cone_watch().step(0, GRASP, FORCES, MU)
    np.testing.assert_array_equal(cones.usable_friction, MU)
    np.testing.assert_allclose(cones.load, per_grasp_force(GRASP, FORCES), atol=1e-12)


def test_f_is_made_for_less_grasp_force_than_there_is_and_for_a_reserve():
    reserve = LoadMarginConfig(floor=0.6, share=0.0)
    cones = cone_watch(reserve=reserve).step(0, GRASP, FORCES, MU)
    expected = per_grasp_force(GRASP, FORCES)
    expected[:, 1] -= 0.2 * np.sqrt(1.0 + 1.0 / MU**2) / parts_of(GRASP, FORCES).grasp_force
    np.testing.assert_allclose(cones.goal, reaches(expected / 0.7, MU), atol=1e-12)


def test_f_is_made_for_the_worst_of_the_recent_past_and_forgets_it():
    """Two loads by turns, then the first alone: for each side the larger one, which fades."""
    none = LoadMarginConfig(floor=0.0, share=0.0)
    watch = cone_watch(reserve=none, load_memory=1.0)
    one, two = watch.step(0, GRASP, FORCES, MU), watch.step(1000 * MS, GRASP, HEAVY, MU)
    three = watch.step(1001 * MS, GRASP, FORCES, MU)
    force = [parts_of(GRASP, forces).grasp_force for forces in (FORCES, HEAVY, FORCES)]
    felt = [k * reaches(c.load, MU) for k, c in zip(force, (one, two, three), strict=True)]
    found = [0.7 * k * c.goal for k, c in zip(force, (one, two, three), strict=True)]
    faded = felt[1] + math.exp(-1.0) * (felt[0] - felt[1])
    np.testing.assert_allclose(found[1], np.maximum(felt[1], faded), atol=1e-12)
    faded = felt[2] + math.exp(-0.001) * (found[1] - felt[2])
    np.testing.assert_allclose(found[2], np.maximum(felt[2], faded), atol=1e-12)
    assert (found[2] > felt[2] + 0.1).any()


def test_the_load_is_followed_by_the_time_that_has_passed():
    """20 ms of time constant, ticks of 5, 10 and 40 ms."""
    watch = cone_watch()
    expected = watch.step(7 * MS, GRASP, FORCES, MU).load
    for stamp, passed, forces in ((12, 5, HEAVY), (22, 10, HEAVY), (62, 40, FORCES)):
        goal = per_grasp_force(GRASP, forces)
        expected = goal + math.exp(-passed / 20.0) * (expected - goal)
        found = watch.step(stamp * MS, GRASP, forces, MU[::-1])
        np.testing.assert_allclose(found.load, expected, atol=1e-12)
        np.testing.assert_array_equal(found.usable_friction, MU[::-1])


def lost(watch):
    positions = GRASP.positions.copy()
    positions[1] = np.nan
    return watch.step(4 * MS, Contacts(positions, GRASP.rotations), FORCES, MU)


INTERRUPTIONS = {
    "a finger is lost": lost,
    "nothing is pressed": lambda watch: watch.step(4 * MS, GRASP, 1e-3 * FORCES, MU),
    "the fingers pull": lambda watch: watch.step(4 * MS, GRASP, -FORCES, MU),
    "the contacts are in line": lambda watch: watch.step(4 * MS, thin(0.005), 9.0 * FORCES, MU),
    "all starts anew": lambda watch: watch.reset(),
}


@pytest.mark.parametrize("happens", INTERRUPTIONS.values(), ids=INTERRUPTIONS)
def test_without_a_grasp_there_are_no_cones_and_the_load_before_it_is_forgotten(happens):
    watch = cone_watch()
    watch.step(3 * MS, GRASP, HEAVY, MU)
    assert happens(watch) is None
    found = watch.step(5 * MS, GRASP, FORCES, MU)
    np.testing.assert_allclose(found.load, per_grasp_force(GRASP, FORCES), atol=1e-12)


def test_after_a_doubt_all_begins_with_the_load_that_is_felt_then():
    """Also the loads of the recent past, which may have been none."""
    reserve = LoadMarginConfig(floor=0.0, share=0.5)
    watch, other = cone_watch(reserve=reserve), cone_watch(reserve=reserve)
    watch.step(3 * MS, GRASP, 3.0 * HEAVY, MU)
    watch.reject_touch(True)
    assert watch.step(5 * MS, GRASP, 3.0 * HEAVY, MU) is None
    watch.reject_touch(False)
    found, fresh = watch.step(7 * MS, GRASP, FORCES, MU), other.step(0, GRASP, FORCES, MU)
    np.testing.assert_array_equal(found.load, fresh.load)
    np.testing.assert_array_equal(found.wanted, fresh.wanted)


def test_a_grasp_force_below_a_tenth_of_a_newton_bears_no_ratio():
    total = parts_of(GRASP, FORCES).grasp_force
    assert cone_watch().step(0, GRASP, 0.0999 / total * FORCES, MU) is None
    found = cone_watch().step(0, GRASP, 0.1001 / total * FORCES, MU)
    np.testing.assert_allclose(found.load, per_grasp_force(GRASP, FORCES), atol=1e-12)


def test_a_grasp_a_hundredth_as_thin_as_long_is_the_limit_for_cones():
    forces = np.array([[0.0, 2.0, 0.0], [0.0, 2.0, 0.0], [0.0, 4.0, 0.0]])
    for margin in (0.0099, 0.0101):
        told = cone_watch().step(0, thin(margin), forces, MU)
        assert (told is not None) == (margin > 0.01)


def needed(load, shape, friction, turn=(0.5, -0.3, 1.1)):
    """Return what holds a contact whose frame (x, n, z) is turned against the axes of forces."""
    frame = rotation_from_vector(turn)
    return required_grasp_force(frame @ load, frame @ shape, frame[:, 1].copy(), friction)


@pytest.mark.parametrize(
    ("load", "shape", "friction", "expected"),
    [
        ((3.0, 0.0, 4.0), (0.0, 0.5, 0.0), 0.4, 25.0),  # 5 N sideways over 0.4 times a half
        ((3.0, 1.0, 4.0), (0.0, 0.5, 0.0), 0.4, 23.0),  # a load that presses helps
        ((0.0, -2.0, 0.0), (0.0, 0.5, 0.0), 0.4, 4.0),  # one that pulls must be overcome first
        ((0.3, 1.0, 0.2), (0.0, 0.5, 0.0), 0.4, 0.0),  # inside already
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.4, 0.0),  # nothing to hold
        ((1.0, 0.0, 0.0), (0.1, 0.5, 0.0), 0.4, 10.0),  # 1 + 0.1 k = 0.2 k
        ((1.0, 0.0, 0.0), (-0.1, 0.5, 0.0), 0.4, 10.0 / 3.0),  # 1 - 0.1 k = 0.2 k
        ((1.0, 0.0, 0.0), (-0.6, 0.5, 0.0), 0.4, 1.25),  # passes through: 1 - 0.6 k = 0.2 k
        ((1.0, 0.0, 0.0), (0.3, 0.5, 0.0), 0.4, math.inf),  # leads away from the cone
        ((1.0, 0.0, 0.5), (-0.6, 0.5, 0.0), 0.4, math.inf),  # passes it by
        ((0.1, -1.0, 0.0), (0.3, 0.5, 0.0), 0.4, math.inf),  # from inside the mirrored cone
        ((1.0, 0.0, 0.0), (-0.6, -0.5, 0.0), 0.4, math.inf),  # through the mirrored cone
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
    """The root is a double one, and rounding must not lose it."""
    found = needed((0.0, -pull, 0.0), (0.0, share, 0.0), friction)
    assert found == pytest.approx(pull / share, rel=1e-5)


@given(
    st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    st.floats(0.05, 1.5),
)
def test_the_grasp_force_that_holds_is_the_least(load, shape, friction):
    """How far inside the cone a force is, is concave in k: it holds on one interval or nowhere."""
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
        # Where the force only grazes the cone, k is a double root, known to sqrt(eps) = 1.5e-8.
        assert inside(k) == pytest.approx(0.0, abs=3e-8 * (1.0 + k))
        assert inside(np.linspace(0.0, 0.999 * k, 100)).max() < 1e-9


def test_a_tick_of_the_optimizer_uses_its_fraction_of_the_learned_friction():
    config = ForceOptimizerConfig(cones=True, cone_share=0.5, shape_time=0.0)
    optimal = ForceOptimizer(config, 3).step(7, GRASP, MU, FORCES)
    load = per_grasp_force(GRASP, FORCES)
    for friction, found in ((0.5 * MU, optimal.cone_margin), (MU, optimal.learned_margin)):
        assert found == pytest.approx(cone_margin(optimal.forces, load, friction), abs=1e-12)


@pytest.mark.parametrize(("friction", "forces"), [(None, FORCES), (MU, None)])
def test_without_friction_or_forces_the_optimizer_leaves_out_the_cones(friction, forces):
    found = ForceOptimizer(ForceOptimizerConfig(cones=True), 3).step(0, GRASP, friction, forces)
    assert found.ok and not found.shaped and math.isnan(found.cone_margin)


def test_a_tick_of_the_optimizer_follows_reset_rejection_and_configuration():
    """Each leaves it where a new one would be."""
    config = ForceOptimizerConfig(cones=True)
    for happens in (
        lambda optimizer: optimizer.reset(),
        lambda optimizer: (
            optimizer.reject_touch(True),
            optimizer.step(4 * MS, GRASP, MU, HEAVY),
            optimizer.reject_touch(False),
        ),
    ):
        optimizer, fresh = ForceOptimizer(config, 3), ForceOptimizer(config, 3)
        optimizer.step(3 * MS, GRASP, MU, HEAVY)
        happens(optimizer)
        found, expected = (each.step(5 * MS, GRASP, MU, FORCES) for each in (optimizer, fresh))
        np.testing.assert_allclose(found.forces, expected.forces, atol=1e-9)
    wider = config.model_copy(update={"cone_share": 1.0})
    optimizer.configure(wider)
    found = optimizer.step(6 * MS, GRASP, MU, FORCES)
    assert found.cone_margin == pytest.approx(found.learned_margin)


def test_the_margin_of_load_is_the_larger_of_its_floor_and_a_fraction_of_the_recent_load():
    margin = LoadMargin(LoadMarginConfig(floor=0.6, share=0.5, memory=2.0), 3, 1.0)
    load = np.array([[0.3, 0.0, 0.4], [0.0, 0.1, 0.0], [0.0, 0.0, 4.0]])
    np.testing.assert_allclose(margin.step(load, 0.0), [0.25, 0.2, 2.0])
    faded = 2.0 * math.exp(-0.5)
    np.testing.assert_allclose(margin.step(0.0 * load, 1.0), [0.2, 0.2, faded])
