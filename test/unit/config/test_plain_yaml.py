# SPDX-License-Identifier: Apache-2.0
"""Malicious files are rejected immediately, in one sentence, whatever they expand to."""

import time

import pytest

from tactile_hand_ros.config.model import Config, param, validate
from tactile_hand_ros.config.plain_yaml import LARGEST, parse_yaml, read_text, yaml_text
from tactile_hand_ros.errors import ConfigurationError

LAUGHS = "name: &a [ha, ha, ha, ha, ha, ha, ha, ha, ha]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


class Deep(Config):
    name: str = param("", "A text")
    numbers: list[float] = param([], "Numbers")


@pytest.mark.parametrize("key", ["name", "numbers", "unknown"])
@pytest.mark.parametrize("value", [LAUGHS + "KEY: *i", "KEY: &x [1, *x]", "KEY: 0x" + "f" * 9000])
def test_a_small_text_that_expands_to_much_is_refused_in_a_short_sentence(key, value):
    start = time.process_time()
    with pytest.raises(ConfigurationError) as caught:
        validate(Deep, parse_yaml(value.replace("KEY", key), "some.yaml"))
    assert time.process_time() - start < 2.0 and len(str(caught.value)) < 2000


@pytest.mark.parametrize("text", ["010", "1:30", "1e3", "1.0e3", "on", "true", "~", "2024-01-01"])
def test_text_is_written_so_that_it_stays_text(text):
    assert parse_yaml(yaml_text({"name": text})) == {"name": text}


def test_a_number_with_an_exponent_is_a_number():
    assert validate(Deep, parse_yaml("numbers: [1e3, 1E-3, 2.5]")).numbers == [1e3, 1e-3, 2.5]


def test_a_key_that_is_given_twice_is_refused_with_its_line():
    with pytest.raises(ConfigurationError, match="line 4, column 3.*the key 'mass' is given twice"):
        parse_yaml("plant:\n  mass: 1\n  size: 2\n  mass: 3\n", "some.yaml")
    assert parse_yaml("a: {mass: 1}\nb: {mass: 2}") == {"a": {"mass": 1}, "b": {"mass": 2}}
    assert parse_yaml("a: &x {m: 1}\nb: {<<: *x, m: 2}")["b"] == {"m": 2}


def test_only_short_files_of_text_are_read(tmp_path):
    (tmp_path / "half").write_bytes(b"ab\xed\xa0\x80")  # half a surrogate pair
    (tmp_path / "large").write_bytes(b"x" * LARGEST)
    assert len(read_text(tmp_path / "large")) == LARGEST
    with (tmp_path / "large").open("ab") as file:
        file.truncate(2**40)
    for path, reason in [
        ("/dev/zero", "it is larger than"),
        (tmp_path, "Is a directory"),
        (tmp_path / "gone", "No such file"),
        (tmp_path / "half", "'utf-8' codec can't decode byte 0xed in position 2"),
        (tmp_path / "large", f"it is larger than {LARGEST} bytes"),
    ]:
        with pytest.raises(ConfigurationError, match=f"{path}: cannot be read: {reason}"):
            read_text(path)
