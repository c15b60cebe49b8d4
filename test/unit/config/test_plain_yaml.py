# SPDX-License-Identifier: Apache-2.0
"""Files of unknown origin are refused at once, in a sentence, whatever they expand to."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from tactile_hand_ros.config.model import Config, param, validate
from tactile_hand_ros.config.plain_yaml import (
    LARGEST,
    parse_yaml,
    read_text,
    yaml_text,
)
from tactile_hand_ros.errors import ConfigurationError

LAUGHS = "name: &a [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi")
)


class Deep(Config):
    name: str = param("", "A text")
    numbers: list[float] = param([], "Numbers")


@pytest.mark.parametrize("key", ["name", "numbers", "unknown"])
@pytest.mark.parametrize("value", [LAUGHS + "KEY: *i", "KEY: &x [1, *x]", "KEY: 0x" + "f" * 9000])
def test_a_small_text_that_expands_to_much_is_refused_in_a_short_sentence(
    key: str, value: str
) -> None:
    start = time.process_time()
    with pytest.raises(ConfigurationError) as caught:
        validate(Deep, parse_yaml(value.replace("KEY", key), "some.yaml"))
    assert time.process_time() - start < 2.0 and len(str(caught.value)) < 2000


@pytest.mark.parametrize(
    "text", [50_000 * "[", "x: " + 50_000 * "{a: ", 3_000 * "- "], ids=["[", "{", "-"]
)
def test_deep_nesting_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match=r"some.yaml: this file .* nested too deeply"):
        parse_yaml(text, "some.yaml")


@pytest.mark.parametrize("text", ["010", "1:30", "1e3", "1.0e3", "on", "true", "~", "2024-01-01"])
def test_text_is_written_so_that_it_stays_text(text: str) -> None:
    assert parse_yaml(yaml_text({"name": text})) == {"name": text}


def test_a_number_with_an_exponent_is_a_number() -> None:
    assert validate(Deep, parse_yaml("numbers: [1e3, 1E-3, 2.5]")).numbers == [1e3, 1e-3, 2.5]


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


def test_what_is_not_text_is_named_by_its_place(tmp_path: Path) -> None:
    (tmp_path / "half").write_bytes(b"ab\xed\xa0\x80")  # half a surrogate pair
    with pytest.raises(ConfigurationError, match="not UTF-8 text, see byte 2"):
        read_text(tmp_path / "half")
