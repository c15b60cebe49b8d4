# SPDX-License-Identifier: Apache-2.0
"""Topics are selected by their full name."""

import pytest

from tactile_hand_ros.config.model import from_flat
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.nodes.recorder.config import RecorderConfig, TopicSelection


@pytest.mark.parametrize(
    ("topic", "chosen"),
    [
        ("/left/joint_states", True),
        ("/right/joint_states", False),
        ("/left/joint_states/raw", True),
        ("/left/debug", False),
        ("/left/_hidden", False),
        ("/prefix/left/joint_states", False),
    ],
)
def test_patterns_match_the_whole_name(topic, chosen):
    assert (topic in TopicSelection(["/left/.*"], [".*/debug"])) is chosen


def test_everything_is_the_default():
    config = RecorderConfig(output="bag")
    selection = TopicSelection(config.topics, config.exclude)
    names = ["/clock", "/rosout", "/diagnostics", "/hand/tactile/contacts", "/parameter_events"]
    assert [name in selection for name in names] == 5 * [True]


@pytest.mark.parametrize("key", ["topics", "exclude"])
def test_broken_pattern_is_refused_with_its_place(key):
    with pytest.raises(ConfigurationError, match=rf"{key}.*'\(' is not a valid regular expression"):
        from_flat(RecorderConfig, {"output": "bag", key: ["("]})
