# SPDX-License-Identifier: Apache-2.0
"""A way to the solution of hard contact problems: smoothed laws that become the exact ones.

With x = (mu p_n, p_t) and z = (w_n / mu + |w_t|, w_t), De Saxce's change of variables, Signorini's
and Coulomb's laws are one: x and z lie in the cone L = {|t| <= n} and x . z = 0. The central path
x o z = s^2 e (o is Jordan's product) of interior-point methods leads from the middle of the cones
to their surface as s goes to zero. Its points are the roots of x - P_s(x - r z), where P_s is the
projection onto L smoothed by s, which Newton's method finds from the last point on.

Source: De Saxce and Feng, The bipotential method, 1998; Fukushima, Luo and Tseng, Smoothing
functions for second-order-cone complementarity problems, 2002.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.jit.compiled import compiled
from tactile_hand_ros.simulation.alart_curnier import Laws
from tactile_hand_ros.simulation.elimination import eliminate

Array = NDArray[np.float64]

_LEAST_FRICTION = 1e-3  # mu of 0 has no cone; Newton's method on the exact laws makes up for it
_END = 1e-9  # of s, per impulse that stops a contact
_NEAR = 1e-3  # residual per s at which a point of the path is near enough
_MAX_NEWTON = 25
_MAX_SYSTEMS = 400
_SLOWEST = 0.98  # factor of s at which the path is given up


@compiled
def follow_path(laws: Laws, rounding: float, padding: float) -> Array:
    """Return impulses at the end of the central path, or as far along it as it could be followed.

    Args:
        laws: The laws.
        rounding: Of |w_t| at its kink, per s.
        padding: Compliance of the contacts per s, which keeps impulses finite where W is singular.

    Returns:
        Impulses p, shape (3c,), N s, near to a solution.
    """
    k, n = len(laws.friction), len(laws.offset)
    mu = np.maximum(laws.friction, _LEAST_FRICTION)
    r = laws.mobility[0::3].copy()
    speed = np.abs(laws.offset).max()
    unit = r.max() * speed
    last, value, slope = np.zeros(n), np.empty(n), np.empty((n, n))
    for i in range(k):
        last[3 * i + 1] = unit / mu[i]
    s, reached, factor, systems = 1.0, 1.0, 0.3, 0
    while s > _END and systems < _MAX_SYSTEMS:
        smooth = np.array([s * unit, rounding * s * speed, padding * s])
        p, near, count = last.copy(), False, 0
        for count in range(_MAX_NEWTON):
            _distance(laws, mu, r, smooth, p, value, slope)
            merit = value @ value
            if merit < (_NEAR * s * unit) ** 2:
                near = True
                break
            step, length, falls = eliminate(slope.copy(), -value), 1.0, False
            systems += 1
            for _ in range(12):
                _distance(laws, mu, r, smooth, p + length * step, value, slope)
                if value @ value < (1.0 - 1e-4 * length) * merit:
                    falls = True
                    break
                length *= 0.5
            if not falls:
                break
            p = p + length * step
        if near:
            last, reached = p, s
            factor = max(factor * factor, 0.05) if count < 5 else factor
        else:
            factor = math.sqrt(factor)
            if factor > _SLOWEST:
                break
        s = reached * factor
    return last


@compiled
def _distance(
    laws: Laws, mu: Array, r: Array, smooth: Array, p: Array, out: Array, slope: Array
) -> None:
    """Write x - P_s(x - r z) and its derivative by p.

    Args:
        laws: The laws.
        mu: Friction, none of it zero, shape (c,).
        r: Mobility of each contact, shape (c,), kg.
        smooth: s in N s, the rounding of |w_t| in m/s, and the compliance of the contacts.
        p: Impulses, shape (3c,), N s.
        out: Written, shape (3c,).
        slope: Written, shape (3c, 3c).
    """
    s, rounding, padding = smooth
    w = laws.delassus
    velocities = w @ p + laws.offset
    for i in range(len(mu)):
        x, n, z = 3 * i, 3 * i + 1, 3 * i + 2
        m, soft = mu[i], padding / r[i]
        wx, wz = velocities[x] + soft * p[x], velocities[z] + soft * p[z]
        wn = velocities[n] + soft * m * m * p[n]
        speed = math.sqrt(wx * wx + wz * wz + rounding * rounding)
        yn, yx, yz = m * p[n] - r[i] * (wn / m + speed), p[x] - r[i] * wx, p[z] - r[i] * wz
        length = math.sqrt(yx * yx + yz * yz)
        ux, uz = (yx / length, yz / length) if length > 0.0 else (1.0, 0.0)
        upper, upper_slope = _positive_part(yn + length, s)
        lower, lower_slope = _positive_part(yn - length, s)
        mean, half = 0.5 * (upper_slope + lower_slope), 0.5 * (upper_slope - lower_slope)
        turn = mean
        if length > 1e-12 * (abs(yn) + s):
            turn = 0.5 * (upper - lower) / length
        out[x] = p[x] - 0.5 * (upper - lower) * ux
        out[n] = m * p[n] - 0.5 * (upper + lower)
        out[z] = p[z] - 0.5 * (upper - lower) * uz
        for j in range(len(p)):
            dx, dn, dz = w[x, j], w[n, j], w[z, j]
            ex, en, ez = 0.0, 0.0, 0.0
            if j == x:
                ex, dx = 1.0, dx + soft
            elif j == n:
                en, dn = m, dn + soft * m * m
            elif j == z:
                ez, dz = 1.0, dz + soft
            gn = en - r[i] * (dn / m + (wx * dx + wz * dz) / speed)
            gx, gz = ex - r[i] * dx, ez - r[i] * dz
            along = ux * gx + uz * gz
            slope[x, j] = ex - half * ux * gn - turn * gx - (mean - turn) * ux * along
            slope[n, j] = en - mean * gn - half * along
            slope[z, j] = ez - half * uz * gn - turn * gz - (mean - turn) * uz * along


@compiled
def _positive_part(y: float, s: float) -> tuple[float, float]:
    """Return (y + sqrt(y^2 + 4 s^2)) / 2, which is max(0, y) smoothed, and its derivative."""
    root = math.sqrt(y * y + 4.0 * s * s)
    value = 0.5 * (y + root) if y > 0.0 else 2.0 * s * s / (root - y)
    return value, value / root
