# SPDX-License-Identifier: Apache-2.0
"""The independent solution of (13): against trying every case, and at its own limits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from support.exact import best_forces
from support.grasps import balance_in_frames, contacts_at, pinch, three_faces

from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.verify.optimum import (
    Problem,
    Pyramids,
    follow,
    gaps,
    imbalance,
    solve,
    solve_inside,
)

Array = NDArray[np.float64]

WEIGHTS = np.array([10.0, 1.0, 7.0, 3.0, 1.5, 9.0, 8.0, 0.5, 4.0])


def tilted(contacts: Contacts, seed: int) -> Contacts:
    """Return contacts moved and turned a little, so that nothing is alike from two sides."""
    random = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(random.uniform(-0.2, 0.2, contacts.positions.shape)).as_matrix()
    shifts = random.uniform(-0.02, 0.02, contacts.positions.shape)
    return Contacts(contacts.positions + shifts, turns @ contacts.rotations)


GRASPS = [tilted(make(), seed) for seed in range(6) for make in (three_faces, pinch)]


def problem_of(grasps: list[Contacts], minimum: float = 0.0, weights: Array = WEIGHTS) -> Problem:
    positions = np.array([grasp.positions for grasp in grasps])
    rotations = np.array([grasp.rotations for grasp in grasps])
    return Problem.of(positions, rotations, weights, minimum)


@pytest.mark.parametrize("minimum", [0.0, 0.2, 0.33])
def test_all_ticks_at_once_have_the_optima_of_trying_every_case(minimum: float) -> None:
    """One of them has none: all fingers push the same way."""
    hopeless = contacts_at(three_faces().positions, np.tile([0.0, 0.0, 1.0], (3, 1)))
    grasps = [*GRASPS[:5], hopeless, *GRASPS[5:]]
    problem = problem_of(grasps, minimum)
    found = solve(problem)
    active = 0
    for i, grasp in enumerate(grasps):
        expected = best_forces(grasp, WEIGHTS, minimum)
        if expected is None:
            assert np.isnan(found.forces[i]).all() and np.isnan(found.multipliers[i]).all()
            continue
        np.testing.assert_allclose(found.forces[i], expected.ravel(), atol=1e-8)
        active += int((found.multipliers[i, 7:] < -1e-9).any())
    assert np.isnan(found.forces[5]).all()
    known = np.isfinite(found.forces[:, 0])
    assert known.sum() > 6 and (active > 0) == (minimum > 0.0)
    worst, gap = gaps(problem.part(np.flatnonzero(known)), found.forces[known],
                      found.multipliers[known])  # fmt: skip
    assert worst.max() < 1e-9 and gap.max() < 1e-9


def test_four_fingers_have_an_optimum_too() -> None:
    points = 0.1 * np.array([[1.0, 0.2, 0.0], [-1.0, 0.1, 0.1], [0.0, 1.0, -0.2], [0.1, -1.1, 0.0]])
    grasp, weights = contacts_at(points, -points), np.tile([2.0, 1.0, 3.0], 4)
    [found] = solve(problem_of([grasp], 0.1, weights)).forces
    expected = best_forces(grasp, weights, 0.1)
    assert expected is not None
    np.testing.assert_allclose(found, expected.ravel(), atol=1e-9)


@pytest.mark.parametrize("direction", range(9))
def test_forces_that_are_not_the_optimum_have_a_residual_and_a_gap(direction: int) -> None:
    """Both by their definitions, for a change of one component by a known amount."""
    problem = problem_of(GRASPS[:1], 0.2)
    best = solve(problem)
    forces = best.forces.copy()
    forces[0, direction] -= 0.3
    [worst], [gap] = gaps(problem, forces, best.multipliers)
    equal, y = problem.equal[0], best.multipliers[0]
    normals = np.kron(np.eye(3), [0.0, 1.0, 0.0])
    unmet = np.abs(equal @ forces[0] - np.eye(7)[6]).max()
    slope = 2.0 * WEIGHTS * forces[0] + equal.T @ y[:7] + normals.T @ y[7:]
    below = max(0.0, (0.2 - normals @ forces[0]).max())
    assert worst == pytest.approx(max(unmet, np.abs(slope).max() / 10.0, below), rel=1e-9)
    cost, least = forces[0] @ (WEIGHTS * forces[0]), best.forces[0] @ (WEIGHTS * best.forces[0])
    assert gap == pytest.approx(abs(cost - least) / cost, rel=1e-6)
    [off] = imbalance(problem, forces)
    assert off == pytest.approx(unmet, rel=1e-9)


def test_balance_is_that_of_forces_and_of_torques_by_the_size_of_the_grasp() -> None:
    """The arms are divided by their root mean square length."""
    for grasp, small in zip(GRASPS[:4], [Contacts(0.01 * g.positions, g.rotations) for g in GRASPS],
                            strict=False):  # fmt: skip
        arms = grasp.positions - grasp.positions.mean(axis=0)
        size = np.sqrt((arms**2).sum() / 3.0)
        expected = balance_in_frames(grasp) / np.repeat([1.0, size], 3)[:, None]
        for problem in (problem_of([grasp]), problem_of([small])):
            np.testing.assert_allclose(problem.equal[0, :6], expected, atol=1e-12)
            np.testing.assert_array_equal(problem.equal[0, 6], np.tile([0.0, 1.0, 0.0], 3))
    none = problem_of(GRASPS).part(np.arange(0))
    assert imbalance(none, np.zeros((0, 9))).shape == (0,)


FRICTION = np.array([0.5, 0.8, 1.1])


def test_a_pyramid_touches_the_cone_along_its_edges() -> None:
    free = Pyramids(FRICTION, np.zeros((3, 12)), 5.0)
    for i, angle in enumerate(np.linspace(0.1, 6.0, 36)):
        finger, at = i % 3, np.pi / 12.0 * i
        forces = np.zeros((3, 3))
        forces[:, 1] = 100.0
        reach = FRICTION[finger] * 2.0 * (np.cos(np.pi / 12.0) if i % 2 == 0 else 1.0)
        forces[finger] = reach * np.cos(at), 2.0, reach * np.sin(at)
        # Even ones are the middles of the sides, odd ones the edges.
        assert free.excess(forces.ravel()) == pytest.approx(0.0, abs=1e-12), angle
        forces[finger, 1] -= 0.1
        outside = 0.1 * np.cos(np.pi / 12.0) * FRICTION[finger]
        assert free.excess(forces.ravel()) == pytest.approx(outside)


def test_pyramids_about_a_load_are_narrower_by_its_reach() -> None:
    load = np.array([[0.1, 0.2, -0.1], [0.0, -0.3, 0.2], [0.3, 0.0, 0.0]])
    about = Pyramids.about(FRICTION, load, 12, 5.0)
    free = Pyramids(FRICTION, np.zeros((3, 12)), 5.0)
    forces = np.array([[0.2, 0.4, 0.1], [0.1, 0.5, 0.2], [0.1, 0.3, 0.0]])
    assert about.sides == 12 and about.penalty == 5.0
    np.testing.assert_allclose(about.bounds, free.beyond(load))
    assert about.excess(forces.ravel()) == pytest.approx(free.excess((forces + load).ravel()))


def cost_of(forces: Array, p: Pyramids) -> float:
    violation = max(0.0, p.excess(forces))
    return float((WEIGHTS / 10.0 * forces**2).sum() + p.penalty * violation + violation**2)


@pytest.mark.parametrize("friction", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("minimum", [0.0, 0.25])
def test_the_optimum_inside_pyramids_costs_less_than_all_around_it(
    friction: float, minimum: float
) -> None:
    """Where the pyramids are too narrow it leaves them as little as pays."""
    random = np.random.default_rng(1)
    for grasp in GRASPS[:4]:
        equal = problem_of([grasp]).equal[0]
        p = Pyramids(np.full(3, friction), np.full((3, 12), 0.01), 0.3)
        forces = solve_inside(equal, WEIGHTS, minimum, p)
        np.testing.assert_allclose(equal @ forces, np.eye(7)[6], atol=1e-9)
        assert forces[1::3].min() > minimum - 1e-9
        ways, least = null_space(equal), cost_of(forces, p)
        for size in (1e-4, 1e-2):
            for _ in range(50):
                other = forces + size * ways @ random.standard_normal(ways.shape[1])
                if other[1::3].min() >= minimum:
                    assert cost_of(other, p) > least - 1e-10


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_f_goes_a_share_of_the_way_from_the_nearest_forces_in_balance(share: float) -> None:
    equal = problem_of(GRASPS[:1]).equal[0]
    wide = Pyramids(np.full(3, 50.0), np.zeros((3, 12)), 5.0)
    [goal] = solve(problem_of(GRASPS[:1])).forces
    way = null_space(equal)[:, 0]
    near, off = goal + 0.05 * way, 0.1 * np.linalg.pinv(equal)[:, 3]
    np.testing.assert_allclose(
        follow(near + off, goal, equal, wide, share), near + share * (goal - near), atol=1e-12
    )


def test_f_goes_at_least_as_far_as_into_the_pyramids() -> None:
    equal = problem_of(GRASPS[:1]).equal[0]
    [goal] = solve(problem_of(GRASPS[:1])).forces
    before = goal + 0.2 * null_space(equal)[:, 0]
    free = Pyramids(FRICTION, np.zeros((3, 12)), 5.0)
    middle = free.excess(before + 0.6 * (goal - before))
    just = Pyramids(FRICTION, np.full((3, 12), -middle), 5.0)
    assert just.excess(before) > 0.0 > just.excess(goal)
    for share, gone in ((0.2, 0.6), (0.8, 0.8)):
        found = follow(before, goal, equal, just, share)
        np.testing.assert_allclose(found, before + gone * (goal - before), atol=1e-9)
    narrow = Pyramids(FRICTION, np.full((3, 12), 10.0), 5.0)  # the goal is outside, too
    np.testing.assert_array_equal(follow(before, goal, equal, narrow, 0.2), goal)
