# SPDX-License-Identifier: Apache-2.0
"""Run the examples of the documentation, and write their numbers and pictures into it.

A fenced block whose first line is a comment with a path is a file of the example. In a block of
kind ``console``, a line that starts with ``$ tactile-hand run`` is run in-process, which gives the
same numbers as the processes; what follows it up to the next command is the result. With
``--check`` nothing is written, and the exit code is 1 when a page differs from its results.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.report.tables import milli
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import UNLIMITED_SLIP, Scenario, load_scenario, resolved

DOCS = Path(__file__).resolve().parent
PAGES = (DOCS.parent / "README.md", DOCS / "first-hour.md", DOCS / "scenarios.md")
FIGURES = DOCS / "figures"
COMMAND = "$ tactile-hand run "

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
    if kind == "console" and COMMAND in body:
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
        f"{each.name:<22}{_milli(each.value, each.unit):>14}   < {1e3 * each.limit:g} m{each.unit}"
        f"   {'pass' if each.passed else 'fail'}"
        for each in found.judged(scenario.goal)
        if each.limit < UNLIMITED_SLIP
    ]
    return [*rows, found.headline()]


def _milli(value: float, unit: str) -> str:
    """Return two digits: more may differ from one processor to the next."""
    return milli(float(f"{value:.2g}"), unit)


def draw(words: str, scenario: Scenario, record: Record) -> None:
    """Draw hand and object of a run at the start and at the end."""
    from tactile_hand_ros.report.scene import grasp_figure

    stem = re.sub(r"\W+", "_", Path(shlex.split(words)[0]).stem)
    file = FIGURES / f"first_hour_{stem}{'_changed' if '--set' in words else ''}.png"
    if file.name in (DOCS / "first-hour.md").read_text(encoding="utf-8"):
        grasp_figure(record, scenario).savefig(file, dpi=110)


def photograph(runs: Sequence[tuple[str, Scenario, Record]]) -> None:
    """Take pictures of the report of the pull and of a comparison, in Chromium.

    Args:
        runs: What the pages have run.
    """
    sys.path.insert(0, str(DOCS.parent / "test"))
    from support.browser import browser
    from support.recorded import write_record

    from tactile_hand_ros.report.page import write_comparison, write_report
    from tactile_hand_ros.run.run import Run

    found = {words: (scenario, record) for words, scenario, record in runs}
    with tempfile.TemporaryDirectory() as name:
        folder, opened = Path(name), {}
        for words in ("pull", "my/target.yaml", "my/law.yaml"):
            scenario, record = found[words]
            told = {"scenario": resolved(scenario), "lost_messages": "0"}
            bag = write_record(folder / scenario.name / "bag", record, custom_data=told)
            opened[words] = Run(bag)
        with browser(folder / "profile") as page:
            page.open(write_report(opened["pull"], folder), size=(1280, 800))
            page.js("report.player.seek(2.03)")
            page.driver.save_screenshot(str(FIGURES / "report.png"))
            pair = [opened["my/target.yaml"], opened["my/law.yaml"]]
            page.open(write_comparison(pair, folder / "comparison.html"), size=(1280, 800))
            page.js("report.player.seek(2.0)")
            page.driver.save_screenshot(str(FIGURES / "first_hour_comparison.png"))


def main() -> int:
    """Draw, or check what is drawn, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, fail if out of date")
    check = parser.parse_args().check
    stale: list[str] = []
    runs: list[tuple[str, Scenario, Record]] = []

    def watch(*run: Any) -> None:
        runs.append(run)
        if not check:
            draw(*run)

    for page in PAGES:
        before = page.read_text(encoding="utf-8")
        after = redrawn(before, watch)
        if after != before:
            stale.append(page.name)
            if not check:
                page.write_text(after, encoding="utf-8")
    if not check:
        photograph(runs)
    print(f"out of date: {', '.join(stale)}" if check and stale else "all pages say what happens")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
