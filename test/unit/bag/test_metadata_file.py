# SPDX-License-Identifier: Apache-2.0
"""metadata.yaml of unknown origin: each value is accepted up to its limit and named beyond it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tactile_hand_ros.bag.metadata_file import check_metadata, check_regular, read_metadata
from tactile_hand_ros.errors import BagError

TOP = "rosbag2_bagfile_information"


def told(folder: Path, **changed: Any) -> Path:
    """Write metadata of a bag with one topic, with some values changed; None removes one."""
    tree: dict[str, Any] = {
        "message_count": 3,
        "duration": {"nanoseconds": 5},
        "starting_time": {"nanoseconds_since_epoch": 7},
        "topics_with_message_count": [
            {"message_count": 3, "topic_metadata": {"name": "/a", "type": "std_msgs/msg/Empty"}}
        ],
        "relative_file_paths": ["run_0.mcap"],
        "custom_data": {"a": "b"},
    }
    tree = {key: value for key, value in (tree | changed).items() if value is not None}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({TOP: tree}))
    return folder


@pytest.mark.parametrize("value", [0, 1, 2**63 - 1])
def test_numbers_up_to_63_bits_are_accepted(tmp_path: Path, value: int) -> None:
    check_metadata(told(tmp_path, message_count=value, duration={"nanoseconds": value}))


@pytest.mark.parametrize("value", [-1, 2**63, 1.0, True, "1", None])
def test_other_numbers_are_not(tmp_path: Path, value: Any) -> None:
    expected = rf"message_count is {value!r}, expected a whole number >= 0 of at most 63 bits"
    with pytest.raises(BagError, match=expected):
        check_metadata(told(tmp_path, message_count=value))
    with pytest.raises(BagError, match="starting_time.nanoseconds_since_epoch is"):
        check_metadata(told(tmp_path, starting_time={"nanoseconds_since_epoch": value}))
    topic = {"message_count": value, "topic_metadata": {"name": "/a", "type": "T"}}
    with pytest.raises(BagError, match=r"topics_with_message_count\[0\].message_count is"):
        check_metadata(told(tmp_path, topics_with_message_count=[topic]))


def test_what_is_not_nested_as_it_should_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="duration.nanoseconds is None"):
        check_metadata(told(tmp_path, duration=5))
    for topics in ("x", [1], [{}, 2]):
        with pytest.raises(BagError, match="expected a list of mappings"):
            check_metadata(told(tmp_path, topics_with_message_count=topics))
    good = {"message_count": 3, "topic_metadata": {"name": "/a", "type": "T"}}
    bad = {"message_count": 3, "topic_metadata": {"name": "/b"}}
    with pytest.raises(BagError, match=r"count\[1\].topic_metadata.type is None, expected a text"):
        check_metadata(told(tmp_path, topics_with_message_count=[good, bad]))


@pytest.mark.parametrize("value", [None, {}, {"a": "b", "c": ""}])
def test_custom_data_are_texts_or_nothing(tmp_path: Path, value: Any) -> None:
    check_metadata(told(tmp_path, custom_data=value))


@pytest.mark.parametrize("value", [["a"], "a", {"a": "b", "c": 1}])
def test_other_custom_data_are_refused(tmp_path: Path, value: Any) -> None:
    with pytest.raises(BagError, match="custom_data is .*, expected texts by name"):
        check_metadata(told(tmp_path, custom_data=value))


@pytest.mark.parametrize("name", ["run_0.mcap", "sub/run_0.mcap", "a..b"])
def test_names_of_files_in_the_folder_are_accepted(tmp_path: Path, name: str) -> None:
    check_metadata(told(tmp_path, relative_file_paths=[name]))


@pytest.mark.parametrize("name", ["", "..", "../x", "/etc/passwd", "a\0b", "a/../b"])
def test_names_that_lead_elsewhere_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(BagError, match="expected names of files in the bag's folder"):
        check_metadata(told(tmp_path, relative_file_paths=["run_0.mcap", name]))
    with pytest.raises(BagError, match="expected a list of file names"):
        check_metadata(told(tmp_path, relative_file_paths=["run_0.mcap", 1]))


def test_each_file_is_looked_at_in_the_folder_itself(tmp_path: Path) -> None:
    (tmp_path / "run_1.mcap").mkdir()
    with pytest.raises(BagError, match="run_1.mcap is a folder, device, pipe or socket"):
        check_metadata(told(tmp_path, relative_file_paths=["run_0.mcap", "sub/run_1.mcap"]))


def test_a_file_or_nothing_at_all_is_regular(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    check_regular(tmp_path / "file")
    check_regular(tmp_path / "absent")
    with pytest.raises(BagError, match="expected a file of a bag"):
        check_regular(tmp_path)


@pytest.mark.parametrize(("length", "shown"), [(58, "x" * 58 + "'"), (59, "x" * 56 + "...")])
def test_long_values_are_shortened(tmp_path: Path, length: int, shown: str) -> None:
    with pytest.raises(BagError, match=f"message_count is '{shown}, expected"):
        check_metadata(told(tmp_path, message_count="x" * length))


def test_the_longest_numbers_are_not_printed(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=f"is {str(2**200 - 1)[:57]}..., expected"):
        check_metadata(told(tmp_path, message_count=2**200 - 1))
    with pytest.raises(BagError, match="is a number of 201 bits"):
        check_metadata(told(tmp_path, message_count=2**200))


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a: 1\nb: [", "metadata.yaml, line 3: "),
        ("[]", f"there is no mapping '{TOP}'"),
        ("a: {}", f"there is no mapping '{TOP}'"),
        (f"{TOP}: []", f"there is no mapping '{TOP}'"),
    ],
)
def test_what_is_no_metadata_is_refused_with_its_place(
    tmp_path: Path, text: str, error: str
) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=error):
        read_metadata(tmp_path)


def test_missing_metadata_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="metadata.yaml: cannot be read: No such file"):
        read_metadata(tmp_path)
