# SPDX-License-Identifier: Apache-2.0
"""What of a run goes into the page: its ticks, gaps, events, fingers, joints and sections."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.recorded import (
    PERIOD,
    START,
    RunWriter,
    joints,
    message,
    random_record,
    write_record,
    write_tick,
)

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report import document, style
from tactile_hand_ros.report.page import MOST_EARLIER, write_comparison, write_report
from tactile_hand_ros.run.events import Event
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved


def seen(ticks: int) -> Any:
    """Return a run, as far as the choice of its ticks is concerned, in which nothing happens."""
    record = Record.empty(ticks, ["a", "b"], ["j", "k"])
    record.stamps[:] = 10_000_000 * np.arange(ticks)
    for array in (record.rates, record.contact_positions, record.grasp_force):
        array[:] = 0.0
    record.forces[:] = [0.0, 1.0, 0.0]
    return SimpleNamespace(record=record, events=[], latencies=np.zeros(ticks))


def test_the_peak_of_each_signal_is_shown_and_so_is_each_event() -> None:
    run = seen(500)
    run.record.rates[101, 1] = -3.0
    run.record.forces[203, 1] = 0.0, 9.0, 0.0
    run.record.forces[305, 0] = 0.5, 1.0, 0.0  # a peak of friction
    run.record.forces[307] = 4.0, 1.0, 0.0
    run.record.contact_positions[307] = np.nan  # of a contact that is not there
    run.record.grasp_force[407] = 2.0
    run.latencies[451] = 0.1
    run.events = [Event(each, "gap", "", "") for each in (-1.0, 0.53, 1.2899, 7.0)]
    rows = set(document._rows(run, 40).tolist())
    assert {0, 53, 101, 129, 203, 305, 407, 451, 499} <= rows and len(rows) < 70
    assert 307 not in rows


def test_a_tick_takes_the_bytes_of_its_numbers() -> None:
    columns = {"time": np.zeros(7), "grip": np.zeros((7, 3)), "force": np.zeros((7, 3, 2))}
    assert document._bytes_per_tick(columns) == 8 + 3 + 4 * 6


def test_a_line_ends_where_a_gap_begins() -> None:
    values = np.arange(10.0)
    found = document._shown(values, np.array([0, 2, 5, 6, 9]), [2, 6])
    np.testing.assert_array_equal(found, [0.0, np.nan, 5.0, np.nan, 9.0])
    np.testing.assert_array_equal(values, np.arange(10.0))


@pytest.fixture
def paper(tmp_path: Path) -> Run:
    """Return a recorded run of the paper's hand."""
    told = {"scenario": resolved(load_scenario("paper"))}
    return Run(write_record(tmp_path / "bag", random_record(12), custom_data=told))


def test_joints_belong_to_the_finger_whose_tip_they_move(paper: Run) -> None:
    """Whatever they are called."""
    record = Record.empty(1, paper.record.finger_names, Hand.load("paper").joint_names)
    record.joint_names[3], record.joint_names[5] = record.joint_names[5], record.joint_names[3]
    paper.__dict__["record"] = record
    tree, problem = document.model.hand(paper)
    assert problem == "" and tree is not None
    found = document._joints(record, tree)
    assert [each["finger"] for each in found] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert [each["place"] for each in found] == [0, 1, 2] * 3
    assert found[0]["label"] == record.joint_names[0].replace("_", " ")
    for tip in tree["tips"]:
        tip["finger"] = "another"
    assert {each["finger"] for each in document._joints(record, tree)} <= {-1, 0, 1, 2}


def test_joints_of_an_unknown_hand_belong_to_the_finger_that_their_name_begins_with() -> None:
    record = Record.empty(1, ["thumb", "ring"], ["ring_1", "wrist", "thumb_1", "ring_2", "palm"])
    found = document._joints(record, None)
    assert [each["finger"] for each in found] == [1, -1, 0, 1, -1]
    assert [each["place"] for each in found] == [0, 0, 0, 1, 1]
    fingers = document._fingers(record)
    assert [each["label"] for each in fingers] == ["thumb", "ring"]
    assert [each["color"] for each in fingers] == [style.finger_color(i) for i in range(2)]


def test_a_run_has_its_name_date_and_events(paper: Run) -> None:
    paper.__dict__["events"] = [Event(1e-3 * i, "gap", "", "") for i in range(401)]
    found = document.run_document(paper, label="the first")
    assert (found["name"], found["label"]) == ("paper", "the first")
    assert document.run_document(paper)["label"] == "paper"
    assert found["recorded"] == "2023-11-14 22:13 UTC"
    assert len(found["events"]) == 400 and found["events"][399]["time"] == pytest.approx(0.399)
    assert (found["shown"], found["ticks"]) == (12, 12)
    assert found["notes"] == []
    [page] = [document.page_document("run", [found])]
    assert (page["format"], page["kind"], page["settings"]) == (1, "run", [])
    assert page["palette"]["axes"] == [style.axis_color(i) for i in range(3)]
    assert page["palette"]["runs"] == [style.run_color(0)]


def test_a_run_that_begins_in_the_dark_has_no_gap_there(tmp_path: Path) -> None:
    """Nothing was drawn before, so that no line has to end."""
    record = random_record(40)
    record.contact_positions[:8] = record.forces[:8] = np.nan
    record.contact_positions[20:30] = record.forces[20:30] = np.nan
    run = Run(write_record(tmp_path / "bag", record))
    found = document.run_document(run, room=1)
    times = record.times
    assert found["gaps"] == [[pytest.approx(times[19]), pytest.approx(times[30])]]
    assert found["shown"] < found["ticks"] == 40


def urdf(length: float) -> str:
    return (
        '<robot name="r"><link name="base"/><joint name="joint_1" type="revolute">'
        f'<parent link="base"/><child link="tip"/><origin xyz="{length} 0 0"/></joint>'
        '<link name="tip"><visual><geometry><sphere radius="0.02"/></geometry></visual></link>'
        "</robot>"
    )


def described(folder: Path, content: Any, told: Mapping[str, str]) -> Run:
    """Return a run whose bag has a message on robot_description."""
    record = random_record(3)
    with RunWriter(folder, dict(told)) as bag:
        bag.write("/robot_description", content, START - 1)
        for row in range(3):
            write_tick(bag, record, row, START + row * PERIOD)
    return Run(folder)


def test_the_hand_that_was_recorded_is_drawn(tmp_path: Path) -> None:
    """Also where the scenario names one; other types of messages do not count."""
    text = message("std_msgs/msg/String", data=urdf(0.5))
    told = {"scenario": resolved(load_scenario("paper"))}
    for name, custom in (("a", {}), ("b", told)):
        tree, problem = document.model.hand(described(tmp_path / name, text, custom))
        assert tree is not None and problem == ""
        assert [link["xyz"][0] for link in tree["links"]] == [0.0, 0.5]
        assert tree["links"][1]["joint"] == 0
        assert tree["tips"] == [{"link": 1, "finger": "", "radius": 0.02}]
    number = message("std_msgs/msg/Float64", data=1.0)
    tree, _ = document.model.hand(described(tmp_path / "c", number, told))
    assert tree is not None and len(tree["links"]) > 9
    tree, problem = document.model.hand(described(tmp_path / "d", number, {}))
    assert tree is None and problem.startswith("The bag has neither the hand's URDF nor")


@pytest.mark.parametrize(
    ("scenario", "words"),
    [
        ("hand: 3", "neither the hand's URDF"),
        ("hand: paper\nlayout: 3", "neither the hand's URDF"),
        ("hand: gone/hand.yaml", "The hand cannot be drawn: "),
        ("plant: {object: {shape: 7}}", "neither the hand's URDF"),
        ("plant: 3", "neither the hand's URDF"),
        ("plant: {rate: 3}", "neither the hand's URDF"),
    ],
)
def test_what_a_scenario_says_wrongly_is_not_drawn(
    scenario: str, words: str, tmp_path: Path
) -> None:
    """A scenario of another version of the package may hold anything."""
    run = Run(write_record(tmp_path / "bag", random_record(3), custom_data={"scenario": scenario}))
    tree, problem = document.model.hand(run)
    assert tree is None and words in problem
    assert document.model.solid(run) is None
    assert bool(document.model._tips(run)) == scenario.startswith("hand: paper")
    if scenario == "plant: 3":
        assert document.run_document(run)["notes"][-1] == problem


def test_a_page_has_the_last_ten_sections(tmp_path: Path) -> None:
    """Also of a bag without any finger."""
    with RunWriter(tmp_path / "bag") as bag:
        for section in range(12):
            for tick in range(2 + section):
                state = joints(tick, ["a"], position=[1.0])
                bag.write("/joint_states", state, START + (100 * section + tick) * 10**9)
    run = Run(tmp_path / "bag")
    assert len(run.earlier) == 11
    assert [len(each.record) for each in run.earlier[-MOST_EARLIER:]] == list(range(4, 13))
    text = write_report(run).read_text(encoding="utf-8")
    assert text.count('"ticks":') == 10 and '"ticks":3,' not in text and '"ticks":13,' in text


def test_results_belong_into_the_folder_of_the_run(tmp_path: Path) -> None:
    """Of a bag without one, beside it."""
    bare = Run(write_record(tmp_path / "run" / "bag", random_record(3)))
    run = Run(tmp_path / "run")
    assert run.folder == bare.folder == tmp_path / "run"
    assert Run(tmp_path / "run" / "bag" / "bag_0.mcap").folder == tmp_path / "run" / "bag"
    other = tmp_path / "new" / "folder" / "both.html"
    assert write_comparison([run, bare], other) == other and other.is_file()
