# SPDX-License-Identifier: Apache-2.0
"""The documentation's examples do what the text says, and its commands and options exist."""

from __future__ import annotations

import glob
import importlib.util
import re
import shlex
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
from support.recorded import write_record

from tactile_hand_ros.cli.app import app
from tactile_hand_ros.cli.app import main as tactile_hand
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.closed_loop.scenario import Scenario, resolved

ROOT = Path(__file__).resolve().parents[2]
TEXTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
_SHORT = slice(0, 60)  # ticks of a run that are enough for commands that read it


def load_tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_pages", ROOT / "docs" / "draw_pages.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tool = load_tool()


def test_the_first_hour_is_as_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All runs of the page, and on what they leave behind all its other commands."""
    text = (ROOT / "docs" / "first-hour.md").read_text("utf-8")

    def keep(words: str, scenario: Scenario, record: Record) -> None:
        folder = tmp_path / "runs" / f"1-{scenario.name}"
        if not folder.exists():
            told = {"scenario": resolved(scenario)}
            write_record(folder / "bag", record.part(_SHORT), custom_data=told)
        latest = tmp_path / "runs" / "latest"
        latest.unlink(missing_ok=True)
        latest.symlink_to(folder)

    assert tool.redrawn(text, keep) == text, "run `make docs-figures`"
    monkeypatch.chdir(tmp_path)
    others = [
        line.removeprefix("$ tactile-hand ")
        for line in text.splitlines()
        if line.startswith("$ ") and not line.startswith(tool.COMMAND)
    ]
    assert len(others) == 3
    for line in others:
        words = [file for word in shlex.split(line) for file in sorted(glob.glob(word)) or [word]]
        assert tactile_hand(words) == 0, line
    assert "my_law:MyLaw" in capsys.readouterr().out  # as a setting that differs
    assert (tmp_path / "comparison.html").is_file()


@pytest.mark.parametrize("page", ["README.md", "docs/scenarios.md"])
def test_the_results_in_a_page_are_those_of_its_runs(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    assert tool.redrawn(text) == text, "run `make docs-figures`"
    assert "\ngoal reached\n" in text


def test_a_promise_that_is_not_kept_is_found() -> None:
    text = (
        "```yaml\n# my/a.yaml\nextends: paper\nduration: 0.01\ntargets: []\n```\n"
        "```console\n$ tactile-hand run my/a.yaml\ngoal not reached\n$ other\nstays\n```\n"
    )
    after = tool.redrawn(text)
    assert "goal reached" in after and "goal not reached" not in after
    assert after.endswith("$ other\nstays\n```\n")


def commands() -> list[tuple[str, str]]:
    """Return each `tactile-hand ...` in the texts, with the page."""
    found = []
    for page in TEXTS:
        for line in re.findall(r"tactile-hand ([a-z][^`\n|)]*)", page.read_text("utf-8")):
            found.append((page.name, line.split("#")[0].strip()))
    return found


@pytest.mark.parametrize(("page", "line"), sorted(set(commands())))
def test_commands_and_options_in_the_texts_exist(page: str, line: str) -> None:
    command: Any = typer.main.get_command(app)
    words = re.findall(r"[^\s,;:]+", line)
    while hasattr(command, "commands"):
        name = words.pop(0).strip(".")
        assert name in command.commands, f"{page}: tactile-hand {line}"
        command = command.commands[name]
    known = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
    for word in words:
        if re.match(r"--[a-z]", word):
            assert word.split("=")[0].rstrip(".") in known, f"{page}: {word} of {line}"
