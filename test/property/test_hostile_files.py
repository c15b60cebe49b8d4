# SPDX-License-Identifier: Apache-2.0
"""Whatever a file holds, reading it ends in time, with a result or an error of this package."""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.hostile import hostile

from tactile_hand_ros.config.plain_yaml import find_file
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.scenario.scenario import load_scenario

LONGEST = 5.0
"""Most processor time that one hostile file may take [s]."""

HOSTILE = hostile(100)
FILES = {"scenario": find_file("scenario", "pull"), "hand": find_file("hand", "paper")}
URDF = (FILES["hand"].parent / "paper.urdf").read_text()
NASTY = (
    ["", "~", "[", "]", "{}", "[]", "&a [*a]", "*a", "!!python/object:os.system ''", "? [a]", "\0"]
    + ["\\", "/", "..", "a/b", "-1", "0", "nan", ".nan", ".inf", "1e308", "-1e308", "1e-320"]
    + ["{a: 1}", "[1, x]", "[[0]]", "null", "2024-01-01", "!!binary aGk=", "-0", "1e-400"]
    + ["9" * 400, "0x" + "f" * 5000, "9" * 5000, "1:1:1", "2024-13-01", "true", "'", '"', "<", ">"]
    + ["\ud7ff", "\x85", "\u2028", "%YAML 9.9", "---", "- " * 200, "[" * 5000, "{a: " * 5000]
)


@contextmanager
def refused_in_time() -> Iterator[None]:
    """Accept an error of this package, in time and in text that can be printed."""
    start = time.process_time()
    try:
        yield
    except TactileHandError as error:
        str(error).encode()
        assert 0 < len(str(error)) < 20_000
    assert time.process_time() - start < LONGEST


@st.composite
def mutated(draw: st.DrawFn, text: str) -> str:
    """Return a text in which some words or lines are replaced, repeated or gone."""
    words = text.split(" ")
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(words) - 1))
        what = draw(st.sampled_from(["replace", "insert", "cut", "repeat"]))
        nasty = draw(st.one_of(st.sampled_from(NASTY), st.text(max_size=8)))
        if what == "replace":
            words[at] = nasty
        elif what == "insert":
            words.insert(at, nasty)
        elif what == "cut":
            del words[at : at + draw(st.integers(1, 20))]
        else:
            words[at:at] = words[at : at + 20] * draw(st.integers(1, 9))
        words = words or [""]
    return " ".join(words)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a good hand."""
    for name in ("paper.yaml", "paper.urdf"):
        shutil.copy(FILES["hand"].parent / name, tmp_path / name)
    return tmp_path


def write(path: Path, text: str) -> Path:
    """Write text as it is; what cannot be encoded is written as its bytes."""
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return path


@HOSTILE
@given(text=mutated(FILES["scenario"].read_text()) | st.text(max_size=40))
@example(text="name: &a [ha, ha]\nplant: {object: {vertices: [" + "0.1, " * 9000 + "]}}")
def test_scenario(folder, text):
    with refused_in_time():
        scenario = load_scenario(str(write(folder / "x.yaml", text)))
        scenario.plant.object.solid()


@HOSTILE
@given(text=mutated(URDF.replace('"', ' " ')) | st.text(max_size=40))
@example(text='<robot name="a">' + "<link>" * 5000)
@example(text="<robot/>")
def test_urdf(folder, text):
    write(folder / "paper.urdf", text)
    with refused_in_time():
        Hand.load(str(folder / "paper.yaml"))
