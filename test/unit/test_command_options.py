# SPDX-License-Identifier: Apache-2.0
"""A command takes the fields of a dataclass as its options."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from tactile_hand_ros.command_options import with_options


@dataclass(frozen=True)
class Options:
    names: Annotated[list[str], typer.Argument(metavar="NAME...")]
    size: Annotated[int, typer.Option("--how-many", help="How many.", min=1)] = 3
    extra: Annotated[list[str], typer.Option(help="More.")] = field(default_factory=list)
    quick: Annotated[bool, typer.Option("--quick")] = False


seen: list[tuple[str, Options]] = []
app = typer.Typer(rich_markup_mode=None)


@app.command()
@with_options
def count(context: typer.Context, options: Options) -> None:
    """Count names."""
    seen.append((str(context.info_name), options))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("a", Options(["a"])),
        ("a b --how-many 5", Options(["a", "b"], size=5)),
        ("a --extra x --extra y --quick", Options(["a"], extra=["x", "y"], quick=True)),
    ],
)
def test_the_fields_are_the_options(line: str, expected: Options) -> None:
    seen.clear()
    assert CliRunner().invoke(app, line.split()).exit_code == 0
    assert seen == [("count", expected)]


@pytest.mark.parametrize("line", ["", "a --how-many 0", "a --size 5"])
def test_what_does_not_fit_a_field_is_refused(line: str) -> None:
    seen.clear()
    assert CliRunner().invoke(app, line.split()).exit_code == 2
    assert not seen
