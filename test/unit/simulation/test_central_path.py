# SPDX-License-Identifier: Apache-2.0
"""The path to the solution of hard contact problems: its parts, and how many systems it takes."""

import math

import numpy as np
import pytest
from support.contact_problems import random_problem

from tactile_hand_ros.simulation.alart_curnier import TOLERANCE, contact_laws, residual
from tactile_hand_ros.simulation.central_path import (
    Curve,
    _begin,
    _corrected,
    _distance,
    _jams,
    _positive_part,
    _smoothed,
    _tangent,
    _weighed,
    follow_path,
)


def laws_of(seed):
    problem = random_problem(seed)
    offset = problem.free.copy()
    offset[1::3] += problem.closing
    return contact_laws(problem.delassus, offset, problem.friction)


def curve_of(laws, rounding=0.1, padding=0.01):
    speed, r = np.abs(laws.offset).max(), laws.mobility[::3].copy()
    friction = np.maximum(laws.friction, 1e-3)
    return Curve(friction, r, np.repeat(r, 3) * speed, speed, rounding, padding)


LAWS = laws_of(5052)
CURVE = curve_of(LAWS)
N = len(LAWS.offset)


def test_the_smoothed_positive_part_is_its_formula_on_both_sides():
    for y in (-3.0, -0.2, 0.0, 0.2, 3.0):
        for s in (0.05, 1.0):
            value, slope = _positive_part(y, s)
            root = math.sqrt(y * y + 4.0 * s * s)
            assert value == pytest.approx(0.5 * (y + root), rel=1e-9)
            assert slope == pytest.approx(0.5 * (1.0 + y / root), rel=1e-9)
    assert _positive_part(-1e9, 1.0)[0] == pytest.approx(1e-9, rel=1e-12)


def expected_distance(laws, curve, u):
    """Return x - P_s(x - r z) per unit, contact by contact, by the spectral form of P_s."""
    s, p = math.exp(u[-1]), u[:-1] * curve.unit
    w, out = laws.delassus @ p + laws.offset, []
    for i, (m, r) in enumerate(zip(curve.friction, curve.mobility, strict=True)):
        part, unit = slice(3 * i, 3 * i + 3), curve.unit[3 * i]
        (px, pn, pz), soft = p[part], curve.padding * s / r
        wx, wn, wz = w[part] + soft * np.array([px, m * m * pn, pz])
        speed = math.hypot(wx, wz, curve.rounding * s * curve.speed)
        y = np.array([m * pn - r * (wn / m + (1.0 - s) * speed), px - r * wx, pz - r * wz])
        length = math.hypot(y[1], y[2])
        across = np.array([0.0, y[1], y[2]]) / length
        projected = sum(
            0.5 * _positive_part(y[0] + sign * length, s * unit)[0] * ([1.0, 0, 0] + sign * across)
            for sign in (1.0, -1.0)
        )
        x = np.array([m * pn, px, pz]) - projected
        out += [x[1] / unit, x[0] / unit, x[2] / unit]
    return np.array(out)


def some_points():
    random = np.random.default_rng(2)
    for log_s in (0.0, -1.0, -4.0):
        u = np.append(random.standard_normal(N), log_s)
        u[1:N:3] = np.abs(u[1:N:3])
        yield u


def test_the_distance_to_the_curve_is_that_of_the_projection_onto_cones():
    value, slope = np.empty(N), np.empty((N, N + 1))
    for u in some_points():
        _distance(LAWS, CURVE, u, value, slope, False)
        np.testing.assert_allclose(value, expected_distance(LAWS, CURVE, u), atol=1e-9)


def test_its_slope_is_that_of_finite_differences():
    value, slope, low, high = np.empty(N), np.empty((N, N + 1)), np.empty(N), np.empty(N)
    for u in some_points():
        _smoothed(LAWS, CURVE, u, value, slope)
        for j in range(N + 1):
            h = 1e-6 * np.eye(N + 1)[j]
            _distance(LAWS, CURVE, u - h, low, slope.copy(), False)
            _distance(LAWS, CURVE, u + h, high, slope.copy(), False)
            size = np.abs(slope[:, j]).max()
            bound = (1e-6 if j < N else 1e-4) * size + 1e-8
            np.testing.assert_allclose(slope[:, j], (high - low) / 2e-6, atol=bound)


def test_without_a_direction_the_slope_stays_finite():
    u, value, slope = np.zeros(N + 1), np.full(N, np.nan), np.full((N, N + 1), np.nan)
    still = LAWS._replace(offset=np.zeros(N))
    _smoothed(still, CURVE, u, value, slope)
    assert np.isfinite(value).all() and np.isfinite(slope).all()


def test_the_metric_and_the_tangent_of_the_curve():
    value, slope = np.empty(N), np.empty((N, N + 1))
    u, systems = _begin(LAWS, CURVE, value, slope)
    assert u[N] == 0.0 and value @ value < 1e-6 and 0 < systems < 20
    down = -np.eye(N + 1)[N]
    row = _weighed(down, u)
    np.testing.assert_array_equal(row, down)
    ones = _weighed(np.ones(N + 1), u)
    np.testing.assert_allclose(ones[:N], 1.0 / (1.0 + np.abs(u[:N]).max()) ** 2, rtol=1e-14)
    assert ones[N] == 1.0
    along = _tangent(slope, row, u)
    np.testing.assert_allclose(slope @ along, 0.0, atol=1e-9 * np.abs(slope).max())
    assert along @ row > 0.0 and along @ _weighed(along, u) == pytest.approx(1.0)
    there, near, taken = _corrected(LAWS, CURVE, u + 0.1 * along, row, value, slope)
    assert near and 0 < taken < 7
    assert np.linalg.norm(value) < 1e-3 * math.exp(there[N])
    assert row @ (there - u - 0.1 * along) == pytest.approx(0.0, abs=1e-12)
    far = u + np.append(np.zeros(N), 1.01)
    assert _corrected(LAWS, CURVE, far, row, value, slope)[1:] == (False, 0)


def test_impulses_jam_that_balance_and_press_on_a_penetration():
    """Two fingers on opposite sides of an object that is too wide."""
    facing = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([1.0, 2.0, 1.0]))
    both, power = np.tile([0.0, 1.0, 0.0], 2), np.array([0.0, -0.3, 0.0, 0.0, 0.0, 1.0])
    jammed = contact_laws(facing, power, np.ones(2))
    assert _jams(jammed, 7.0 * both) and not _jams(jammed, -7.0 * both)
    for share, jams in ((4.9e-5, True), (5.1e-5, False)):
        moved = both + np.array([0.0, -share, 0.0, 0.0, 0.0, 0.0])
        assert _jams(jammed, moved) == jams
    for press, jams in ((0.99e-4, False), (1.01e-4, True)):
        pressing = contact_laws(facing, np.array([0, -press, 0, 0, 0, 1.0]), np.ones(2))
        assert _jams(pressing, both) == jams


# Linear systems that the first path takes until the laws hold or the object proves to be jammed.
TAKEN = {5717: 202, 2659: 133, 112: 150, 265: 69}


@pytest.mark.parametrize("seed", TAKEN)
def test_a_path_takes_as_many_systems_as_it_always_has(seed):
    """One less, and it has not arrived."""
    laws, jams = laws_of(seed), seed in (112, 265)
    p, left, jammed = follow_path(laws, 0.1, 0.01, TAKEN[seed])
    assert jammed == jams and (left < TOLERANCE) != jams
    assert residual(laws, p) == pytest.approx(left, abs=1e-14)
    _, left, jammed = follow_path(laws, 0.1, 0.01, TAKEN[seed] - 1)
    assert not jammed and not left < TOLERANCE
