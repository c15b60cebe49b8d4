# SPDX-License-Identifier: Apache-2.0
"""Spaces: their syntax on the command line, and the points in them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.sweep.engine import Study
from tactile_hand_ros.sweep.space import Choice, Range, parse_parameter, points

SPACE = {"a": Range(0.0, 2.0), "b": Range(0.1, 10.0, is_log=True), "c": Choice(("u", "v"))}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("m=0.05..0.5", Range(0.05, 0.5)),
        ("m=-1..1/5", Choice([-1.0, -0.5, 0.0, 0.5, 1.0])),
        ("m=1e-3..1:log", Range(1e-3, 1.0, is_log=True)),
        ("m=1..16/3:log", Choice([1.0, 4.0, 16.0])),
        ("n=1..6", Choice(range(1, 7))),
        ("n=1..10/4", Choice([1, 4, 7, 10])),
        ("n=1..2/9", Choice([1, 2])),
        ("m=a,b", Choice(("a", "b"))),
        ("m=[[0, 0, -9.81], [0, 0, 0]]", Choice(([0, 0, -9.81], [0, 0, 0]))),
        ("m=true,false", Choice((True, False))),
        ("m=7", Choice((7,))),
        ("m=../a.yaml,../b.yaml", Choice(("../a.yaml", "../b.yaml"))),
        ("m=[../a.yaml]", Choice(("../a.yaml",))),
    ],
)
def test_what_is_varied_is_read(text, expected):
    assert parse_parameter(text, whole="n") == (text[0], expected)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("m", "expected PATH= and LOW..HIGH"),
        ("m=", "expected PATH= and LOW..HIGH"),
        ("m=2..1", "expected the lower bound first"),
        ("m=1..1", "expected the lower bound first"),
        ("m=0..1:log", "expected bounds above 0"),
        ("m=1..2:lin", "expected LOW..HIGH"),
        ("m=1..x", "expected LOW..HIGH"),
        ("m=0..inf", "expected LOW..HIGH"),
        ("m=0..1/1", "expected 2 or more"),
        ("m=0..1/1000000000", "expected at most 100000 levels"),
        ("m=[]", "expected LOW..HIGH"),
        ("n=0.5..2", "expected whole numbers"),
        ("n=1..1e9", "expected at most 100000 whole numbers"),
    ],
)
def test_what_cannot_be_varied_is_refused_in_a_sentence(text, told):
    with pytest.raises(ConfigurationError, match=f"^--over.*{told}"):
        parse_parameter(text, whole="n")


@given(st.floats(0.0, 1.0))
def test_a_share_is_a_value_of_the_parameter(fraction):
    assert 0.1 <= SPACE["b"].value(fraction) <= 10.0 * (1.0 + 1e-12)
    assert Choice("abc").value(fraction) in "abc"


def test_ranges_are_sampled_by_a_latin_hypercube_that_repeats():
    """A continued study finds the runs that it would have executed."""
    found = points(SPACE, 50, 3)
    for column in found.T:
        assert sorted((50 * column).astype(int)) == list(range(50))
    np.testing.assert_array_equal(points(SPACE, 50, 3), found)
    assert not np.array_equal(points(SPACE, 50, 4), found)


def test_choices_are_combined():
    space = {"a": Choice([0.0, 1.0, 2.0]), "c": Choice(("u", "v", "w", "x", "y"))}
    study = Study(space, dict)
    found = [tuple(study.point(i).values.values()) for i in range(len(study.fractions))]
    assert found == [(a, c) for a in (0.0, 1.0, 2.0) for c in "uvwxy"]
    sampled = Study(space | {"b": Range(0.0, 1.0)}, dict, runs=60)
    values = [sampled.point(i).values["a"] for i in range(60)]
    assert np.unique(values, return_counts=True)[1].tolist() == [20] * 3
