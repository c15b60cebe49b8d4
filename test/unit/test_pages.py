# SPDX-License-Identifier: Apache-2.0
"""The documentation's examples work as described, and its commands and options exist."""

import glob
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer
from support.recorded import write_record

from tactile_hand_ros.cli.app import EXAMPLES, app
from tactile_hand_ros.cli.app import main as tactile_hand
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.run.result import columns
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, resolved

ROOT = Path(__file__).resolve().parents[2]
TEXTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
_NUMBER = re.compile(r"(?<![\w./-])\d+(?:\.\d+)?")
_SHORT = slice(0, 60)  # ticks of a run, sufficient for commands that read it


tool = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "draw_pages.py")))


@pytest.fixture(scope="module", autouse=True)
def _each_run_is_made_once() -> Iterator[None]:
    """Execute each run once: pages share runs, which repeat to the bit."""
    run, made = ClosedLoop.run, dict[str, Record]()

    def once(loop: ClosedLoop) -> Record:
        key = loop.scenario.model_dump_json()
        return made[key] if key in made else made.setdefault(key, run(loop))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ClosedLoop, "run", once)
        yield


def page(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def agree(line: str, other: str) -> bool:
    """Whether lines agree up to differences between processors.

    Rounding changes small errors caused by noise: by a tenth of the largest number in the line,
    which is the goal if it is met.
    """
    ours, theirs = (np.array(_NUMBER.findall(each), dtype=float) for each in (line, other))
    same = _NUMBER.sub("", line).split() == _NUMBER.sub("", other).split()
    return same and bool((np.abs(ours - theirs) <= 0.1 * theirs.max(initial=0.0)).all())


def check_agreement(redrawn: str, text: str) -> None:
    pairs = zip(redrawn.splitlines(), text.splitlines(), strict=True)
    stale = "\n".join(ours for ours, theirs in pairs if not agree(ours, theirs))
    assert not stale, f"run `make docs-figures`:\n{stale}"


def test_the_tutorial_shows_what_its_commands_print(tmp_path, monkeypatch):
    text = page("docs/tutorials/getting-started.md")

    def keep(words: str, scenario: Scenario, record: Record) -> None:
        folder = tmp_path / "runs" / f"1-{scenario.name}"
        if not folder.exists():
            written = {"scenario": resolved(scenario)}
            write_record(folder / "bag", record.part(_SHORT), custom_data=written)
        latest = tmp_path / "runs" / "latest"
        latest.unlink(missing_ok=True)
        latest.symlink_to(folder)

    check_agreement(tool.redrawn(text, keep), text)
    monkeypatch.chdir(tmp_path)
    others = [
        line.removeprefix("$ tactile-hand ")
        for line in text.splitlines()
        if line.startswith("$ ") and not line.startswith(tool.COMMAND)
    ]
    assert len(others) == 2
    for line in others:
        words = [file for word in shlex.split(line) for file in sorted(glob.glob(word)) or [word]]
        assert tactile_hand(words) == 0, line
    assert (tmp_path / "runs" / "latest" / "report.html").is_file()


@pytest.fixture
def own_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder with the files of the page about your own hand, including the URDF."""
    folder = tmp_path / "my"
    folder.mkdir()
    text = page("docs/tutorials/your-own-hand.md")
    for name, body in re.findall(r"^```\w+\n# my/([\w.]+)(.*?)^```$", text, re.M | re.S):
        (folder / name).write_text("#" + body)
    runpy.run_path(str(folder / "make_hand.py"), run_name="__main__")
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.mark.parametrize("name", ["how-to/scenarios.md", "tutorials/your-own-hand.md"])
def test_a_page_shows_what_its_commands_print(name):
    text, kept = page(f"docs/{name}"), list[Record]()
    check_agreement(tool.redrawn(text, lambda *run: kept.append(run[2])), text)
    assert "\ngoal reached" in text
    for names in re.findall(r"frame\[\[(.*?)\]\]", text):
        assert set(re.findall(r'"([\w.]+)"', names)) <= set(columns(kept[0]))


def test_grippers_and_fingers_of_two_joints_hold_as_the_page_says(own_hand):
    assert "hold with grasp force and slip prevention" in page("docs/tutorials/your-own-hand.md")
    urdf, hand = own_hand / "my_hand.urdf", own_hand / "my_hand.yaml"
    whole, text = urdf.read_text(), hand.read_text()
    fixed = whole.replace('_abduction" type="revolute"', '_abduction" type="fixed"')
    angles = "plant.initial_joints=[1.309,1.1697]"
    for left_out, model, changes in ((r".*name: middle.*\n", whole, []), ("$^", fixed, [angles])):
        hand.write_text(re.sub(left_out, "", text))
        urdf.write_text(model)
        changes = parse_changes([*changes, "targets=[]", "duration=0.3"])
        record = ClosedLoop(load_scenario("my/hold.yaml", changes)).run()
        assert len(record) == 301 and record.true_slid[-1].max() < 1e-3


def test_a_bag_is_read_as_its_page_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    record = ClosedLoop(load_scenario("paper", parse_changes(["duration=0.6"]))).run()
    write_record(tmp_path / "runs" / "latest" / "bag", record.part(_SHORT))
    exec(fenced(page("docs/how-to/record-and-replay.md").split("Raw messages")[1], "python"), {})
    assert len(capsys.readouterr().out.splitlines()) == 60


@pytest.mark.parametrize("name", ["README.md", "docs/how-to/scenarios.md", "docs/how-to/sweeps.md"])
def test_the_python_of_a_page_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(fenced(page(name), "python").replace("runs=4", "runs=1, jobs=1"), {})
    printed = capsys.readouterr().out
    if name == "README.md":
        assert printed.startswith("auto: goal reached") and "user: object dropped" in printed
        assert (tmp_path / "report.html").is_file()


def fenced(text: str, kind: str) -> str:
    """Return the first block of a kind."""
    found = re.search(rf"^```{kind}\n(.*?)^```$", text, re.M | re.S)
    assert found
    return found.group(1)


def test_a_hand_of_ones_own_is_tried_by_the_commands_of_its_page(own_hand, monkeypatch):
    monkeypatch.chdir(own_hand)
    lines = re.findall(r"`tactile-hand ((?:hand|grasp) .*?)`", page("docs/how-to/real-hand.md"))
    assert [tactile_hand(line.split()) for line in lines] == [0, 0]
    [written] = (own_hand / "my").glob("my_hand_*.yaml")
    record = ClosedLoop(load_scenario(str(written), {"duration": 0.1})).run()
    assert record.finger_names == ["thumb", "index", "middle"]
    assert np.isfinite(record.true_positions).all()


def test_the_drivers_loop_of_the_page_holds_the_joints(own_hand, monkeypatch):
    """Its code as printed, for ten ticks without a command."""
    monkeypatch.chdir(own_hand)
    ticks = iter(range(10))
    applied: list[Any] = []
    told: list[str] = []

    def read_joints() -> tuple[Any, Any]:
        next(ticks)
        return np.full(9, 0.1), np.full(9, 0.2)

    driver = {
        "read_joints": read_joints,
        "now_ns": lambda: 2_000_000 * len(applied),
        "publish_joint_states": lambda *_: None,
        "motors": SimpleNamespace(apply=applied.append),
        "publish_joint_hold": lambda _: None,
        "report": told.append,
    }
    with pytest.raises(StopIteration):
        exec(fenced(page("docs/how-to/real-hand.md"), "python"), driver)
    assert len(applied) == 10 and all(np.isfinite(torque).all() for torque in applied)
    assert (applied[-1] != 0.0).any() and told[-1].endswith("; the joints are held")


def test_a_robot_description_is_handed_on_as_its_page_says(tmp_path, monkeypatch):
    """ros2 ends what it echoes with a line ---, which is no XML."""
    ros2 = tmp_path / "ros2"
    ros2.write_text("#!/bin/sh\nprintf '<robot>\\n</robot>\\n---\\n'\n")
    ros2.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    [value] = re.findall(r'robot_description:=("\$\(.*\)")$', page("docs/how-to/live.md"), re.M)
    assert "ros2 topic echo --once --field data" in value
    assert subprocess.check_output(["sh", "-c", f"printf %s {value}"]) == b"<robot>\n</robot>"


def test_the_files_that_pages_name_exist():
    folders = [ROOT / name for name in ("tactile_hand_ros", "test", "bench", "studies", "docs")]
    there = [f"/{path.relative_to(ROOT)}" for folder in folders for path in folder.rglob("*.py")]
    for path in TEXTS:
        for name in re.findall(r"`(?!my/)([\w/]+\.py)`", path.read_text("utf-8")):
            assert any(file.endswith(f"/{name}") for file in there), f"{path.name}: {name}"


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_links_into_the_tree_lead_somewhere(name):
    """Links between pages of the site are checked when it is built."""
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page(name)):
        file, _, anchor = link.partition("#")
        target = ROOT / (file or name)
        assert target.exists(), link
        if anchor:
            titles = re.findall(r"^#+ (.+)$", target.read_text("utf-8"), re.M)
            assert anchor in [title.lower().replace(" ", "-") for title in titles], link


def test_the_site_builds_without_warnings_and_needs_no_network(tmp_path):
    shutil.copy(ROOT / "mkdocs.yml", tmp_path)
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    command = [Path(sys.executable).with_name("zensical"), "build", "--strict"]
    options = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": "docs"}, "text": True}
    built = subprocess.run(command, capture_output=True, **options)
    assert built.returncode == 0 and "No issues found" in built.stderr, built.stdout + built.stderr
    pages = {path.stem: path.read_text("utf-8") for path in (tmp_path / "site").rglob("*.html")}
    for name, text in pages.items():
        assert not re.search(r"<(?:script|link|img)[^>]*(?:src|href)=.?https?:", text), name
    assert "<math" in pages["overview"] and "front_door.simulate" in pages["api"]
    assert "tactile-hand run" in pages["commands"]
    # The notebook was executed.
    assert pages["paper"].count("data:image/png") == 4 and "a contact is lost" in pages["paper"]


def commands() -> list[tuple[str, str]]:
    """Return each `tactile-hand ...` in the texts and in the help, with the page."""
    found = [("--help", example) for example in EXAMPLES.values()]
    for path in TEXTS:
        for line in re.findall(r"tactile-hand ([a-z][^`\n|)]*)", path.read_text("utf-8")):
            found.append((path.name, line.split("#")[0].strip()))
    return found


@pytest.mark.parametrize(("name", "line"), sorted(set(commands())))
def test_commands_and_options_in_the_texts_exist(name, line):
    command: Any = typer.main.get_command(app)
    words = re.findall(r"[^\s,;:]+", line)
    while hasattr(command, "commands"):
        subcommand = words.pop(0).strip(".")
        assert subcommand in command.commands, f"{name}: tactile-hand {line}"
        command = command.commands[subcommand]
    known = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
    for word in words:
        if re.match(r"--[a-z]", word):
            assert word.split("=")[0].rstrip(".") in known, f"{name}: {word} of {line}"
