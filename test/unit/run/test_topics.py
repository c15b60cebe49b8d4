# SPDX-License-Identifier: Apache-2.0
"""Hands and fingers are found in a bag by their topics."""

import pytest

from tactile_hand_ros.errors import BagError
from tactile_hand_ros.run.reading import find_fingers, find_prefix


@pytest.mark.parametrize(
    ("namespace", "prefix"), [("left", "/left/"), ("/left/", "/left/"), ("", "/"), ("/", "/")]
)
def test_the_only_hand_is_found_or_the_one_that_is_chosen(namespace, prefix):
    given = ["/left/joint_states", "/joint_states", "/right/joint_states"]
    assert find_prefix(given, namespace, "bag") == prefix
    assert find_prefix([f"{prefix}joint_states", "/clock"], None, "bag") == prefix


@pytest.mark.parametrize(
    ("topics", "namespace", "found"),
    [
        ("/right/joint_states /left/joint_states", None, "left, right"),
        ("/left/joint_states", "up", "left"),
        ("/joint_states_raw /other_joint_states /clock", None, "none"),
    ],
)
def test_a_hand_that_is_not_clear_is_refused(topics, namespace, found):
    with pytest.raises(BagError, match=f"in the namespaces: {found}; choose one"):
        find_prefix(topics.split(), namespace, "bag")


def test_fingers_in_natural_order_and_of_this_hand_only():
    given = [
        "/l/tactile/f10/wrench",
        "/l/optimal_force/f2",
        "/l/ground_truth/f1/wrench",
        "/r/tactile/f3/wrench",
        "/l/tactile/contacts",
    ]
    assert find_fingers(given, "/l/") == ["f1", "f2", "f10"]
