# SPDX-License-Identifier: Apache-2.0
"""A way to the solution of hard contact problems: smoothed laws that become the exact ones.

With x = (mu p_n, p_t) and z = (w_n / mu + |w_t|, w_t), De Saxce's change of variables, Signorini's
and Coulomb's laws are one: x and z lie in the cone L = {|t| <= n} and x . z = 0. Smoothed by s they
are x o z = s^2 e (o is Jordan's product), the roots of x - P_s(x - r z), where P_s is the smoothed
projection onto L. With (1 - s) |w_t| in z and contacts that give in proportion to s, there is one
root at s = 1, where the normal impulses do not depend on how fast contacts slide, and none is
infinite. So the curve of roots (p, s) that begins there does not end before s = 0, though it may
turn back on its way: it is followed by its length, not by s, with a predictor and a corrector. At
s = 0 it arrives at a solution, or goes to infinity along impulses that jam the object.

Source: De Saxce and Feng, The bipotential method, 1998; Fukushima, Luo and Tseng, Smoothing
functions for second-order-cone complementarity problems, 2002; Allgower and Georg, Numerical
Continuation Methods, 1990.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.compiled import compiled
from tactile_hand_ros.simulation.alart_curnier import TOLERANCE, Laws, eliminate, into_cones, newton

Array = NDArray[np.float64]

_LEAST_FRICTION = 1e-3  # mu of 0 has no cone; Newton's method on the exact laws makes up for it
_NEAR = 1e-3  # residual per s at which a point is on the curve
_FIRST, _LONGEST, _SHORTEST = 0.3, 4.0, 1e-8  # steps along the curve; log s counts as its length
_STRAIGHT = 0.8  # cosine of the largest turn in a step: a larger one may have left the curve
_MAX_BEGIN = 60
_MAX_CORRECTIONS = 7
_BEYOND = 1.0  # log s from which the curve has been left, too
_END = math.log(1e-10)
_GOAL = math.log(1e-2)  # of log s: how often the exact laws are tried
_JAM = 5e-5  # velocities by impulses of size 1 that jam, per largest element of W
_PRESSING = 1e-4  # their power, per fastest velocity without impulses
_DIFFERENCE = 1e-5  # of log s


class Curve(NamedTuple):
    """What the smoothed laws need besides the laws.

    Attributes:
        friction: mu, none of it zero, shape (c,).
        mobility: r of each contact, shape (c,), kg.
        unit: Impulses that count as 1, shape (3c,), N s.
        speed: Fastest velocity without impulses, m/s.
        rounding: Of |w_t| at its kink, per s and speed.
        padding: Compliance of the contacts per s, which keeps impulses finite where W is singular.
    """

    friction: Array
    mobility: Array
    unit: Array
    speed: float
    rounding: float
    padding: float


@compiled
def follow_path(
    laws: Laws, rounding: float, padding: float, most: int
) -> tuple[Array, float, bool]:
    """Follow the curve and try the exact laws from some of its points.

    Args:
        laws: The laws.
        rounding: Of |w_t| at its kink, per s and speed.
        padding: Compliance of the contacts, per s.
        most: Linear systems after which it is given up.

    Returns:
        The best impulses p found, shape (3c,), N s, their residual, and whether they go
        to infinity: the object is jammed.
    """
    n = len(laws.offset)
    r = laws.mobility[0::3].copy()
    speed = np.abs(laws.offset).max()
    friction = np.maximum(laws.friction, _LEAST_FRICTION)
    curve = Curve(friction, r, np.repeat(r, 3) * speed, speed, rounding, padding)
    value, slope = np.empty(n), np.empty((n, n + 1))
    u, systems = _begin(laws, curve, value, slope)
    direction = np.zeros(n + 1)
    direction[n] = -1.0
    best, left = u[:n] * curve.unit, np.inf
    length, goal = _FIRST, _GOAL
    while systems < most and length > _SHORTEST and u[n] > _END:
        row = _weighed(direction, u)
        v, near, taken = _corrected(laws, curve, u + length * direction, row, value, slope)
        systems += taken + 1
        following = direction
        if near:
            following = _tangent(slope, row, v)
            cosine = float(following @ _weighed(direction, v))
            near = cosine > _STRAIGHT or length < 100.0 * _SHORTEST
        if not near:
            length *= 0.4
            continue
        u, direction = v, following
        length = min(length * (2.0 if taken < 3 else 1.0), _LONGEST)
        if u[n] < goal:
            goal += _GOAL
            p, _ = newton(laws, u[:n] * curve.unit, 1.0)
            found = into_cones(laws, p)
            if found < left:
                best, left = p, found
            if left < TOLERANCE:
                break
            if _jams(laws, u[:n] * curve.unit):
                break
    return best, left, not left < TOLERANCE and _jams(laws, u[:n] * curve.unit)


@compiled
def _begin(laws: Laws, curve: Curve, value: Array, slope: Array) -> tuple[Array, int]:
    """Return the root at s = 1, impulses per unit and log s, and the systems that it took.

    The problem is monotone there: Newton's method with halved steps arrives from anywhere.
    """
    n, systems = len(value), 0
    u = np.zeros(n + 1)
    u[1:n:3] = 1.0 / curve.friction
    for systems in range(_MAX_BEGIN):
        _smoothed(laws, curve, u, value, slope)
        merit = value @ value
        if merit < _NEAR**2:
            break
        step, length = eliminate(slope[:, :n].copy(), -value), 1.0
        for _ in range(12):
            trial = u.copy()
            trial[:n] += length * step
            _smoothed(laws, curve, trial, value, slope)
            if value @ value < (1.0 - 1e-4 * length) * merit:
                break
            length *= 0.5
        u[:n] += length * step
    return u, systems


@compiled
def _corrected(
    laws: Laws, curve: Curve, guess: Array, row: Array, value: Array, slope: Array
) -> tuple[Array, bool, int]:
    """Go from a guess to the curve, across `row`; return where to, whether there, and systems."""
    n = len(value)
    v, before = guess, np.inf
    matrix, right = np.empty((n + 1, n + 1)), np.empty(n + 1)
    for count in range(_MAX_CORRECTIONS):
        if not v[n] < _BEYOND:
            return v, False, count
        _smoothed(laws, curve, v, value, slope)
        size = math.sqrt(value @ value)
        if size < _NEAR * math.exp(v[n]):
            return v, True, count
        if count > 1 and not size < 2.0 * before:
            return v, False, count
        before = size
        matrix[:n], matrix[n] = slope, row
        right[:n], right[n] = -value, row @ (guess - v)
        v = v + eliminate(matrix, right)
    return v, False, _MAX_CORRECTIONS


@compiled
def _tangent(slope: Array, row: Array, u: Array) -> Array:
    """Return the direction of the curve at u, of length 1, that goes on along `row`."""
    n = len(slope)
    matrix, right = np.empty((n + 1, n + 1)), np.zeros(n + 1)
    matrix[:n], matrix[n] = slope, row
    right[n] = 1.0
    along = eliminate(matrix, right)
    out: Array = along / math.sqrt(along @ _weighed(along, u))
    return out


@compiled
def _weighed(direction: Array, u: Array) -> Array:
    """Return a direction times the metric at u: impulses count by their share of the largest."""
    n = len(u) - 1
    out = direction.copy()
    out[:n] /= (1.0 + np.abs(u[:n]).max()) ** 2
    return out


@compiled
def _jams(laws: Laws, p: Array) -> bool:
    """Return whether impulses of the curve go to infinity: they balance and press on gaps < 0."""
    d = p / max(np.abs(p).max(), 1e-300)
    moved = np.abs(laws.delassus @ d).max() < _JAM * np.abs(laws.delassus).max()
    power: float = d @ laws.offset
    return bool(moved and power < -_PRESSING * np.abs(laws.offset).max())


@compiled
def _smoothed(laws: Laws, curve: Curve, u: Array, value: Array, slope: Array) -> None:
    """Write x - P_s(x - r z) per unit, shape (3c,), and its derivative by u, shape (3c, 3c + 1)."""
    n = len(value)
    other = u.copy()
    other[n] += _DIFFERENCE
    _distance(laws, curve, other, value, slope, False)
    slope[:, n] = value
    _distance(laws, curve, u, value, slope, True)
    slope[:, n] = (slope[:, n] - value) / _DIFFERENCE


@compiled
def _distance(laws: Laws, curve: Curve, u: Array, out: Array, slope: Array, sloped: bool) -> None:
    """Write x - P_s(x - r z) per unit, shape (3c,), and its derivative by u[:-1] if wanted."""
    w, unit = laws.delassus, curve.unit
    s, p = math.exp(u[len(out)]), u[: len(out)] * unit
    velocities = w @ p + laws.offset
    for i in range(len(curve.friction)):
        x, n, z = 3 * i, 3 * i + 1, 3 * i + 2
        m, r = curve.friction[i], curve.mobility[i]
        soft, rounded, own = curve.padding * s / r, curve.rounding * s * curve.speed, s * unit[x]
        wx, wz = velocities[x] + soft * p[x], velocities[z] + soft * p[z]
        wn = velocities[n] + soft * m * m * p[n]
        speed = math.sqrt(wx * wx + wz * wz + rounded * rounded)
        yn, yx, yz = m * p[n] - r * (wn / m + (1.0 - s) * speed), p[x] - r * wx, p[z] - r * wz
        length = math.sqrt(yx * yx + yz * yz)
        ux, uz = (yx / length, yz / length) if length > 0.0 else (1.0, 0.0)
        upper, upper_slope = _positive_part(yn + length, own)
        lower, lower_slope = _positive_part(yn - length, own)
        out[x] = (p[x] - 0.5 * (upper - lower) * ux) / unit[x]
        out[n] = (m * p[n] - 0.5 * (upper + lower)) / unit[n]
        out[z] = (p[z] - 0.5 * (upper - lower) * uz) / unit[z]
        if not sloped:
            continue
        mean, half = 0.5 * (upper_slope + lower_slope), 0.5 * (upper_slope - lower_slope)
        turn = mean
        if length > 1e-12 * (abs(yn) + own):
            turn = 0.5 * (upper - lower) / length
        for j in range(len(p)):
            dx, dn, dz = w[x, j], w[n, j], w[z, j]
            ex, en, ez = 0.0, 0.0, 0.0
            if j == x:
                ex, dx = 1.0, dx + soft
            elif j == n:
                en, dn = m, dn + soft * m * m
            elif j == z:
                ez, dz = 1.0, dz + soft
            gn = en - r * (dn / m + (1.0 - s) * (wx * dx + wz * dz) / speed)
            gx, gz = ex - r * dx, ez - r * dz
            along, share = ux * gx + uz * gz, unit[j] / unit[x]
            slope[x, j] = share * (ex - half * ux * gn - turn * gx - (mean - turn) * ux * along)
            slope[n, j] = share * (en - mean * gn - half * along)
            slope[z, j] = share * (ez - half * uz * gn - turn * gz - (mean - turn) * uz * along)


@compiled
def _positive_part(y: float, s: float) -> tuple[float, float]:
    """Return (y + sqrt(y^2 + 4 s^2)) / 2, which is max(0, y) smoothed, and its derivative."""
    root = math.sqrt(y * y + 4.0 * s * s)
    value = 0.5 * (y + root) if y > 0.0 else 2.0 * s * s / (root - y)
    return value, value / root
