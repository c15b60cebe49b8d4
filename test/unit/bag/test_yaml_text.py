# SPDX-License-Identifier: Apache-2.0
"""The YAML texts are laid out as yaml-cpp does and read back as they were."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.bag.yaml_text import dump, load

_LEAVES = st.none() | st.booleans() | st.integers() | st.text()
_TREES = st.recursive(
    _LEAVES,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, min_size=1, max_size=4)
    ),
    max_leaves=12,
)


def test_layout_is_that_of_yaml_cpp() -> None:
    """Sequences in mappings are indented, an empty one stands on its own line."""
    tree = {"a": 1, "b": [{"c": "x/y", "d": {"e": False}}, {"f": []}], "g": {}, "h": "", "i": []}
    expected = """\
a: 1
b:
  - c: x/y
    d:
      e: false
  - f:
      []
g: ~
h: ""
i:
  []"""
    assert dump(tree) == expected


@given(_TREES)
def test_text_reads_back_as_the_same_tree(tree: object) -> None:
    """No text is mistaken for a number, a boolean or a structure."""
    assert yaml.safe_load(dump(tree)) == tree


@pytest.mark.parametrize(
    "text",
    [
        "2024-13-01",
        "!!timestamp soon",
        "!!bool perhaps",
        "!!float ''",
        "[",
    ],
)
def test_a_value_that_is_not_what_it_seems_is_no_yaml(text: str) -> None:
    with pytest.raises(yaml.YAMLError):
        load(text)


@pytest.mark.parametrize(
    ("value", "text"),
    [("a\nb", '"a\\U0000000ab"'), ('"\\', '"\\"\\\\"'), ("é", '"é"'), ("No", '"No"'), (7, "7")],
)
def test_texts_that_are_not_plain_are_quoted(value: object, text: str) -> None:
    assert dump(value) == text and yaml.safe_load(text) == value
