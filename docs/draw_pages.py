# SPDX-License-Identifier: Apache-2.0
"""Run the examples of the documentation, and write their numbers and pictures into it.

A fenced block whose first line is a comment with a path is a file of the example. In a block of
kind ``console``, a line that starts with ``$ tactile-hand run`` is run in-process, which gives the
same numbers as the processes. Below it stand those lines of its output that have a goal; an
ellipsis stands for the others. A script after ``$ python`` is run too.
"""

from __future__ import annotations

import argparse
import os
import re
import runpy
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.report.page import Result
from tactile_hand_ros.report.tables import milli
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import UNLIMITED_SLIP, Scenario, load_scenario

DOCS = Path(__file__).resolve().parent
TUTORIAL = DOCS / "tutorials" / "getting-started.md"
OWN_HAND = DOCS / "tutorials" / "your-own-hand.md"
PAGES = (TUTORIAL, OWN_HAND, DOCS / "how-to" / "scenarios.md")
FIGURES = DOCS / "figures"
COMMAND, SCRIPT = "$ tactile-hand run ", "$ python "

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)
_FILE = re.compile(r"# ([\w./-]+\.(?:yaml|py))\b")

Watch = Callable[[str, Scenario, Record], None]


def redrawn(text: str, watch: Watch = lambda *_: None) -> str:
    """Return a page with the results that its examples have now.

    Args:
        text: The page.
        watch: Called for each run with the words of its command, its scenario and its record.
    """
    with _workshop():
        return _BLOCK.sub(lambda found: _block(found, watch), text)


@contextmanager
def _workshop() -> Iterator[None]:
    """Work in a folder of its own, in which the pages' files are written."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield
        finally:
            os.chdir(before)


def _block(found: re.Match[str], watch: Watch) -> str:
    kind, body = found.groups()
    named = _FILE.match(body)
    if named and kind in ("yaml", "python"):
        file = Path(named.group(1))
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(body, encoding="utf-8")
    if kind == "console":
        body = "\n".join(_results(body, watch)) + "\n"
    return f"```{kind}\n{body}```"


def _results(body: str, watch: Watch) -> Iterator[str]:
    """Yield the commands of a block, each followed by what it gives."""
    known = False
    for line in body.splitlines():
        if line.startswith(COMMAND):
            known = True
            yield line
            yield from _run(line.removeprefix(COMMAND), watch)
        elif line.startswith("$ "):
            known = False
            if line.startswith(SCRIPT):
                runpy.run_path(line.removeprefix(SCRIPT), run_name="__main__")
        if not known:
            yield line


def _run(words: str, watch: Watch) -> list[str]:
    parser = argparse.ArgumentParser()
    parser.add_argument("scenario")
    parser.add_argument("--set", action="append", default=[])
    given = parser.parse_args(shlex.split(words))
    scenario = load_scenario(given.scenario, parse_changes(given.set))
    record = ClosedLoop(scenario).run()
    watch(words, scenario, record)
    found = metrics(record, scenario)
    rows = [
        f"│ {each.name:<20} │ {milli(each.value, each.unit):<14} "
        f"│ < {f'{1e3 * each.limit:g} m{each.unit}':<7} │ {'pass' if each.passed else 'fail'} │"
        for each in found.judged(scenario.goal)
        if each.limit < UNLIMITED_SLIP
    ]
    return ["…", *rows, "…", f"{found.headline()}; results: runs/…-{scenario.name}"]


def draw(words: str, scenario: Scenario, record: Record) -> None:
    """Draw hand and object of a run at the start and at the end."""
    from tactile_hand_ros.report.scene import grasp_figure

    file = FIGURES / f"getting_started_{Path(shlex.split(words)[0]).stem}.png"
    if "--set" not in words and file.name in TUTORIAL.read_text(encoding="utf-8"):
        grasp_figure(record, scenario).savefig(file, dpi=110)


def photograph(scenario: Scenario, record: Record) -> None:
    """Take a picture of the report of a run, in Chromium.

    Args:
        scenario: Its scenario.
        record: The run.
    """
    sys.path.insert(0, str(DOCS.parent / "test"))
    from support.browser import browser

    with tempfile.TemporaryDirectory() as folder, browser(Path(folder) / "profile") as page:
        page.open(Result(record, scenario).report(folder), size=(1280, 800))
        page.js("report.player.seek(2.03)")
        page.driver.save_screenshot(str(FIGURES / "report.png"))


def main() -> None:
    """Write results and pictures."""

    def watch(words: str, scenario: Scenario, record: Record) -> None:
        draw(words, scenario, record)
        if words == "human_pull":
            photograph(scenario, record)

    for page in PAGES:
        page.write_text(redrawn(page.read_text(encoding="utf-8"), watch), encoding="utf-8")


if __name__ == "__main__":
    main()
