# SPDX-License-Identifier: Apache-2.0
"""Runs that are compared are told apart by their settings."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tactile_hand_ros.report.facts import differing, labels


def run(folder: str, **settings: Any) -> Any:
    """Return a run as far as its settings are concerned."""
    return SimpleNamespace(
        path=Path("/runs") / folder, name=settings.get("name", folder), loose_scenario=settings
    )


def test_each_setting_that_differs_is_a_row() -> None:
    runs = [
        run("a", name="x", description="one", law={"name": "own", "k": 1.0}, rate=5, same=[1]),
        run("b", name="y", description="two", law={"name": "own", "k": 2.0}, rate=5, same=[1]),
        run("c", name="z", law={"name": "other", "k": 1.0}, rate=None, same=[1], more=True),
    ]
    assert differing(runs) == [
        ["law.name", "own", "own", "other"],
        ["law.k", "1.0", "2.0", "1.0"],
        ["rate", "5", "5", ""],
        ["more", "not set", "not set", "True"],
    ]
    assert labels(runs) == ["x", "y", "z"]


def test_where_a_law_lies_makes_no_difference() -> None:
    laws = [{"law": {"folder": folder}} for folder in ("/a", "/b")]
    runs = [run("a", manipulation_controller=law) for law in laws]
    assert differing(runs) == []
    assert differing([run("a", **law) for law in laws]) == [["law.folder", "/a", "/b"]]


def test_long_values_are_cut_after_sixty_letters() -> None:
    runs = [run("a", text=letter * size) for letter, size in (("x", 60), ("y", 61))]
    assert differing(runs) == [["text", "x" * 60, "y" * 60 + "..."]]


def test_two_settings_stand_in_a_label_and_the_others_are_counted() -> None:
    values = [{"a": {"p": n}, "q": n, "r": n, "s": n} for n in (1, 2)]
    assert labels([run("u", name="x", **each) for each in values]) == [
        "x (p=1, q=1, 2 more)",
        "x (p=2, q=2, 2 more)",
    ]
    two = [{"a": {"p": n}, "q": n} for n in (1, 2)]
    assert labels([run("u", name="x", **each) for each in two]) == ["x (p=1, q=1)", "x (p=2, q=2)"]
    assert labels([run(folder, name="x") for folder in "uv"]) == ["x (u)", "x (v)"]
