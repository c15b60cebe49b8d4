# SPDX-License-Identifier: Apache-2.0
"""Friction cones and their pyramids, on hand-made forces."""

import math

import numpy as np
import pytest

from tactile_hand_ros.control.optimizer.cones import SIDES, Cones

MU = np.array([0.5, 0.3, 0.8])
FORCES = np.array([[0.1, 0.4, -0.05], [0.0, 0.5, 0.02], [-0.04, 0.1, 0.03]])
LOAD = np.array([[0.02, 0.1, 0.05], [-0.03, 0.1, 0.02], [0.01, 0.0, 0.01]])
# With the load: mu n is 0.25, 0.18 and 0.08; the tangents are (0.12, 0), (-0.03, 0.04), (-0.03,
# 0.04).
MARGINS = np.array([0.13, 0.13, 0.03])


def turned(size, angle):
    """Return a tangential force of a size and direction, without a normal part."""
    return np.array([size * math.cos(angle), 0.0, size * math.sin(angle)])


def bears(force, friction=0.5, finger=1, load=(0.0, 0.0, 0.0)):
    """Return whether one of three contacts holds a force, next to two that always hold theirs."""
    forces, loads = np.tile([0.0, 1.0, 0.0], (3, 1)), np.zeros((3, 3))
    forces[finger], loads[finger] = force, load
    mu = np.full(3, 0.1)
    mu[finger] = friction
    return Cones(mu, loads).holds(forces)


def test_the_margin_is_that_of_the_contact_nearest_to_its_own_cone_with_its_load():
    assert Cones(MU, LOAD).margin(FORCES) == pytest.approx(0.03)
    for finger in range(3):
        forces = FORCES.copy()
        forces[finger, 0] += math.copysign(0.3, forces[finger, 0])
        x, n, z = forces[finger] + LOAD[finger]
        margin = MU[finger] * n - math.sqrt(x * x + z * z)
        assert margin < 0.0
        assert Cones(MU, LOAD).margin(forces) == pytest.approx(margin)
        np.testing.assert_allclose(
            Cones(MU[[finger]], LOAD[[finger]]).margin(FORCES[[finger]]), MARGINS[finger]
        )


@pytest.mark.parametrize("finger", range(3))
@pytest.mark.parametrize("side", range(SIDES))
def test_the_pyramid_has_twelve_sides_and_its_edges_on_the_cone(side, finger):
    """Across a side it reaches cos 15 degrees of mu f_n, along an edge mu f_n itself."""
    cone, normal = 0.5 * 2.0, np.array([0.0, 2.0, 0.0])
    for steps, reach in ((side, cone * math.cos(math.radians(15.0))), (side + 0.5, cone)):
        for share in (0.999, 1.001):
            force = normal + turned(share * reach, math.radians(30.0) * steps)
            assert bears(force, finger=finger) == (share < 1.0)


def test_what_lies_on_a_side_is_borne():
    on = np.array([math.cos(math.pi / 12.0), 1.0, 0.0])
    assert bears(on, friction=1.0)
    assert not bears(on + [1e-15, 0.0, 0.0], friction=1.0)


def test_the_load_counts_for_the_pyramid_as_it_does_for_the_cone():
    assert bears([0.2, 1.0, 0.0]) and not bears([0.2, 1.0, 0.0], load=(0.3, 0.0, 0.0))
    assert not bears([0.6, 1.0, 0.0]) and bears([0.6, 1.0, 0.0], load=(0.0, 0.4, 0.0))
    assert bears([0.6, 1.0, 0.1], load=(-0.4, 0.0, -0.2))


def test_a_contact_that_pulls_is_outside_and_so_is_an_unknown_one():
    assert not bears([0.0, -1.0, 0.0])
    assert Cones(MU, 0.0 * LOAD).margin(-FORCES) < 0.0
    assert not bears([np.nan, 1.0, 0.0]) and not bears([0.0, np.nan, 0.0])


def test_f_is_made_for_what_is_wanted_where_that_is_more_than_the_load():
    wanted = np.full((3, SIDES), -1.0)
    loaded = Cones(MU, np.full((3, 3), 0.5))
    assert not loaded.holds(FORCES)
    assert Cones(MU, loaded.load, wanted=wanted).holds(FORCES)
    wanted[1, 4] = 0.5
    more = Cones(MU, 0.0 * LOAD, wanted=wanted)
    assert not more.holds(FORCES) and Cones(MU, 0.0 * LOAD).holds(FORCES)
    np.testing.assert_array_equal(more.goal, wanted)
    assert more.margin(FORCES) == Cones(MU, 0.0 * LOAD).margin(FORCES)
