# SPDX-License-Identifier: Apache-2.0
"""The optimization (13): known solutions, reasons for infeasibility, and recovery from both."""

import numpy as np
import pytest
from support.exact import best_forces
from support.grasps import HALF, contacts_at, moved, pinch, three_faces

from tactile_hand_ros.control.optimizer.cones import Cones
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    Status,
)
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.rotations import rotation_from_vector

W = np.tile([10.0, 1.0, 10.0], 3)
# Fingers 1 and 2 oppose each other and carry the push of finger 3 by friction. With its fraction
# t on each, f_n = ((1 - 2t)/2, (1 - 2t)/2, 2t), of cost (1 - 2t)^2/2 + 4t^2 + 20t^2, minimal
# at t = 1/26. Finger 1 has +y as its x, finger 2 as its -x.
THREE_FACES = np.array([[1 / 26, 6 / 13, 0.0], [-1 / 26, 6 / 13, 0.0], [0.0, 1 / 13, 0.0]])
SLIPPERY = Cones(np.full(3, 0.05), np.zeros((3, 3)))


def optimizer(fingers=3, **values):
    return ForceOptimizer(ForceOptimizerConfig(**values), fingers)


def same_side():
    """Three fingers on one face: no pushing forces balance."""
    points = 0.1 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
    return contacts_at(points, np.tile([0.0, 0.0, 1.0], (3, 1)))


def without_finger(contacts, finger):
    return contacts.without(np.arange(3) == finger)


def beside():
    """Finger 3 next to two opposed ones: the bound on its normal force is active."""
    points = np.array([[HALF, 0.0, 0.0], [-HALF, 0.0, 0.0], [0.0, HALF, 0.05]])
    return contacts_at(points, [[-1.0, 0, 0.1], [1.0, 0, 0.1], [0, -0.1, 1.0]])


def test_normals_that_cannot_balance_are_a_status_with_a_reason():
    found = optimizer().solve(same_side())
    assert found.status is Status.UNBALANCED and not found.ok
    assert "opposing face" in found.reason
    assert np.isnan(found.forces).all() and np.isnan(found.residual)


def test_a_missing_contact_is_named():
    found = optimizer().solve(without_finger(without_finger(three_faces(), 0), 2))
    assert found.status is Status.CONTACT_MISSING
    assert "finger 1, 3" in found.reason and np.isnan(found.forces).all()
    assert (found.iterations, found.solve_time, found.shaped) == (0, 0.0, False)
    assert np.isnan([found.residual, found.cone_margin]).all() and found.forces.shape == (3, 3)
    assert not optimizer().solve(three_faces(), Cones(np.full(3, 0.5), np.zeros((3, 3)))).shaped


@pytest.mark.parametrize(
    "problem",
    [same_side(), without_finger(three_faces(), 1), contacts_at(np.eye(3) * 0, np.eye(3))],
)
def test_after_no_answer_the_next_grasp_gets_its_own(problem):
    solver = optimizer()
    solver.solve(pinch())
    for _ in range(3):
        assert not solver.solve(problem).ok
        np.testing.assert_allclose(solver.solve(three_faces()).forces, THREE_FACES, atol=1e-10)


def test_equal_histories_give_equal_bits():
    turns = [rotation_from_vector([0.001 * i, 0.002 * i, 0.0]) for i in range(50)]
    grasps = [moved(three_faces(), t, np.zeros(3)) for t in turns] + [same_side(), pinch()]
    for solver, first_grasp in (("exact", beside()), ("osqp", pinch())):
        first, second = optimizer(solver=solver), optimizer(solver=solver)
        used = second.solve(first_grasp)
        assert solver == "osqp" or abs(used.forces[2, 1]) < 1e-12
        second.reset()
        for grasp in [*grasps, beside(), three_faces()]:
            one, two = first.solve(grasp), second.solve(grasp)
            np.testing.assert_array_equal(one.forces, two.forces)
            assert one.iterations == two.iterations


def test_the_next_solution_starts_with_the_last_active_bounds():
    solver = optimizer()
    first = solver.solve(beside()).iterations
    assert solver.solve(beside()).iterations == 1 < first
    found = solver.solve(three_faces())
    np.testing.assert_allclose(found.forces, THREE_FACES, atol=1e-10)
    assert found.iterations > optimizer().solve(three_faces()).iterations


def test_contacts_a_thousandth_as_thin_as_long_are_taken_for_a_line():
    for margin in (0.99e-3, 1.01e-3):
        points = 0.1 * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0.0, margin * np.sqrt(3.0), 0]])
        found = optimizer().solve(contacts_at(points, [[0, 1.0, 0], [0, 1.0, 0], [0, -1.0, 0]]))
        assert (found.status is Status.COLLINEAR) == ("line" in found.reason) == (margin < 1e-3)
        assert np.isnan(found.forces).all() or margin > 1e-3


def test_new_weights_take_effect_and_refused_ones_change_nothing():
    solver, cones = optimizer(), Cones(np.full(3, 0.2), np.zeros((3, 3)))
    assert not solver.solve(three_faces(), cones).shaped
    solver.configure(ForceOptimizerConfig(weights=[1.0, 1.0, 1.0]))
    found = solver.solve(three_faces(), cones)
    assert found.shaped and found.forces[0, 0] > 0.18 * found.forces[0, 1]
    equal = solver.solve(three_faces()).forces
    assert equal[2, 1] == pytest.approx(0.25)
    for weights in ([1.0, 2.0, 3.0, 4.0], [1.0, 0.0, 1.0], [-1.0, 1.0, 1.0]):
        with pytest.raises(ConfigurationError, match="3 or 9 positive numbers"):
            solver.configure(ForceOptimizerConfig(weights=weights))
        assert solver.config.weights == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(solver.solve(three_faces()).forces, equal, atol=1e-12)


def test_minimum_normal_forces_that_add_up_to_more_than_one_are_rejected():
    assert optimizer(fingers=3, minimum_normal=0.3).config.minimum_normal == 0.3
    assert optimizer(fingers=4, minimum_normal=0.2499).config.minimum_normal == 0.2499
    for share in (0.25, 0.3):  # with a quarter each, nothing is left to share
        with pytest.raises(ConfigurationError, match=rf"= {share}: 4 contacts.*below 0.25"):
            optimizer(fingers=4, minimum_normal=share)


def limited(program, **values):
    """Let the OSQP of a program stop early."""
    program._set_up()
    program._osqp.update_settings(**values)


@pytest.mark.parametrize("least", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("grasp", [three_faces, pinch, beside])
@pytest.mark.parametrize(("solver", "exactness"), [("exact", 1e-10), ("osqp", 1e-8)])
def test_the_optimum_is_found_to_its_last_digits(solver, exactness, grasp, least):
    found = optimizer(solver=solver, minimum_normal=least).solve(grasp())
    assert found.ok and not found.shaped and found.reason == ""
    assert found.residual < 1e-9 and found.iterations > 0
    assert (found.solve_time > 0.0) == (solver == "osqp")
    np.testing.assert_allclose(found.forces, best_forces(grasp(), W, least), atol=exactness)


def test_an_answer_counts_by_its_residual_where_osqp_stops_at_its_limit():
    """OSQP never converges, but the exact solution has no residual."""
    solver = optimizer(solver="osqp")
    limited(solver._program, max_iter=1)
    found = solver.solve(three_faces())
    assert found.ok and found.residual < 1e-12
    np.testing.assert_allclose(found.forces, THREE_FACES, atol=1e-10)


@pytest.mark.parametrize(
    "values",
    [
        {"max_iter": 1},  # at its limit
        {"eps_abs": 1e6, "eps_rel": 1e6, "polishing": False},  # content with anything
    ],
)
def test_where_nothing_meets_the_conditions_the_solver_has_failed_and_starts_again(values):
    made = optimizer(solver="osqp")
    limited(made._program, **values)
    found = made.solve(same_side())
    assert found.status is Status.FAILED and np.isnan(found.forces).all()
    assert "OSQP ended with '" in found.reason and "the best residual is " in found.reason
    np.testing.assert_allclose(made.solve(three_faces()).forces, THREE_FACES, atol=1e-10)


def test_where_the_cones_cannot_be_kept_exactly_enough_f_is_that_of_the_paper():
    made = optimizer(solver="osqp")
    assert made.solve(three_faces(), SLIPPERY).shaped
    limited(made._shaper._program, max_iter=1)
    hard = Cones(np.full(3, 0.05), np.zeros((3, 3)), wanted=np.full((3, 12), np.inf))
    found = made.solve(three_faces(), hard)
    assert found.ok and not found.shaped and SLIPPERY.wanted is None
    np.testing.assert_allclose(found.forces, THREE_FACES, atol=1e-9)
    assert made.solve(three_faces(), SLIPPERY).shaped
