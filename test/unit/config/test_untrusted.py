# SPDX-License-Identifier: Apache-2.0
"""Files of unknown origin are refused at once, in a sentence, whatever they expand to."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
import yaml

from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.config.untrusted import LARGEST, MOST_VALUES, check_yaml, read_text
from tactile_hand_ros.errors import ConfigurationError

LAUGHS = "name: &a [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi")
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAUGHS, f"line 5, column .* holds more than {MOST_VALUES} values"),
        ("x: [" + "1, " * (MOST_VALUES + 1) + "]", f"more than {MOST_VALUES} values"),
        (50_000 * "[", "line 1, column 51 is not valid YAML: it is nested more than 50 deep"),
        ("x: " + 50_000 * "{a: ", "nested more than 50 deep"),
        (3_000 * "- ", "nested more than 50 deep"),
        ("\n".join("  " * i + "a:" for i in range(3_000)), "nested more than 50 deep"),
        ("x: &x [1, *x]", r"line 1, column 11 .*'\*x' refers to what it is part of"),
        ("x: *y", "undefined alias"),
    ],
    ids=["laughs", "many", "brackets", "braces", "dashes", "indents", "itself", "unknown"],
)
def test_yaml_that_expands_to_much_is_refused_at_once(text: str, message: str) -> None:
    start = time.process_time()
    with pytest.raises(ConfigurationError, match=message) as caught:
        parse_yaml(text, "some.yaml")
    assert time.process_time() - start < 2.0
    assert str(caught.value).startswith("some.yaml: ") and len(str(caught.value)) < 200


def test_references_within_bounds_are_followed() -> None:
    assert parse_yaml("a: &a {x: 1}\nb: [*a, *a]") == {"a": {"x": 1}, "b": [{"x": 1}, {"x": 1}]}


def test_only_files_that_end_are_read(tmp_path: Path) -> None:
    """A device has no end, and a pipe waits for somebody who writes."""
    os.mkfifo(tmp_path / "pipe")
    for path, kind in [
        ("/dev/zero", "a device, pipe or socket"),
        (tmp_path / "pipe", "a device, pipe or socket"),
        (tmp_path, "a folder"),
    ]:
        with pytest.raises(ConfigurationError, match=f"{path}: cannot be read: it is {kind}"):
            read_text(path)


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    (tmp_path / "large").write_bytes(b"x" * LARGEST)
    assert len(read_text(tmp_path / "large")) == LARGEST
    with (tmp_path / "large").open("ab") as file:
        file.truncate(2**40)
    with pytest.raises(ConfigurationError, match=f"larger than {LARGEST} bytes"):
        read_text(tmp_path / "large")


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b"])
def test_a_name_that_no_file_can_have(name: str) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read") as caught:
        read_text(name)
    str(caught.value).encode()


def test_what_is_not_text_is_named_by_its_place(tmp_path: Path) -> None:
    (tmp_path / "half").write_bytes(b"ab\xed\xa0\x80")  # half a surrogate pair
    with pytest.raises(ConfigurationError, match="not UTF-8 text, see byte 2"):
        read_text(tmp_path / "half")


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("7", 1),
        ("[]", 1),
        ("{a: 1, b: 2}", 5),
        ("[1, [2, 3], {}]", 6),
        ("[&a [1, 2], *a, *a]", 10),
        ("[&a 1, *a]", 3),
        ("&a [&b [1], *b, *b]", 7),
    ],
)
def test_every_value_counts_also_those_that_references_repeat(text: str, size: int) -> None:
    check_yaml(text, size)
    with pytest.raises(yaml.YAMLError, match=f"more than {size - 1} values"):
        check_yaml(text, size - 1)


@pytest.mark.parametrize("kind", ["[]", "{}"])
def test_fifty_collections_may_stand_in_each_other(kind: str) -> None:
    for depth, fits in ((50, True), (51, False)):
        text = "[" * depth + "]" * depth if kind == "[]" else "{a: " * depth + "1" + "}" * depth
        if fits:
            check_yaml(text)
        else:
            with pytest.raises(yaml.YAMLError, match="nested more than 50 deep"):
                check_yaml(text)
    check_yaml("[" + "[], " * 60 + "]")


def test_a_file_has_a_mebibyte_and_20000_values_at_most() -> None:
    assert (LARGEST, MOST_VALUES) == (1_048_576, 20_000)


def test_a_file_of_any_limit_is_read_to_its_last_byte(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"abcde")
    assert read_text(tmp_path / "file", 5) == "abcde"
    with pytest.raises(ConfigurationError, match="larger than 4 bytes"):
        read_text(tmp_path / "file", 4)
