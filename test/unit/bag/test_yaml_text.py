# SPDX-License-Identifier: Apache-2.0
"""The YAML texts are laid out as yaml-cpp does and read back as they were."""

from __future__ import annotations

import yaml
from hypothesis import given
from hypothesis import strategies as st

from tactile_hand_ros.bag.yaml_text import dump

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
