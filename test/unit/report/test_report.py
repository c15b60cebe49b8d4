# SPDX-License-Identifier: Apache-2.0
"""The page carries the numbers of the run and nothing that would have to be loaded."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from support.recorded import (
    PERIOD,
    START,
    RunWriter,
    header,
    joints,
    message,
    random_record,
    write_record,
    write_tick,
)

from tactile_hand_ros.cli import app as cli
from tactile_hand_ros.command_line import EXIT_REFUSED
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.report.document import pack, run_document, scene_columns, shown
from tactile_hand_ros.report.facts import differing, labels
from tactile_hand_ros.report.page import write_comparison, write_report
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved

LOADS = ("src", "href", "srcset", "action", "data", "poster", "background", "manifest", "ping")
CALLS = r"\bfetch\(|XMLHttpRequest|WebSocket|EventSource|sendBeacon|importScripts|\bimport\("


class Parts(HTMLParser):
    """Collects what a page would load, and the texts of its scripts and styles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[tuple[str, str]] = []
        self.tags: list[str] = []
        self.texts: dict[str, list[str]] = {}
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.tags.append(tag)
        self.loads += [(tag, values[name] or "") for name in LOADS if name in values]
        self._inside = values.get("id") or tag

    def handle_data(self, data: str) -> None:
        self.texts.setdefault(self._inside, []).append(data)

    @property
    def document(self) -> dict:
        return json.loads("".join(self.texts["document"]))


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return Run(write_record(tmp_path / "bag", random_record(40)))


def test_a_reset_begins_a_section_and_hides_nothing(tmp_path: Path) -> None:
    first, second = random_record(30, seed=2), random_record(12, seed=3)
    with RunWriter(tmp_path / "bag") as bag:
        for begin, record in ((0, first), (30, second)):
            for row in range(len(record)):
                write_tick(bag, record, row, START + (begin + row) * PERIOD, "/")
        for service, row in (("grasp", 5), ("reset", 31)):
            stamp = int((first if row < 30 else second).stamps[row % 30])
            status = message(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=0,
                name="manipulation_controller",
                message=service,
                hardware_id="",
                values=[message("diagnostic_msgs/msg/KeyValue", key=service, value="false")],
            )
            array = message(
                "diagnostic_msgs/msg/DiagnosticArray", header=header(stamp), status=[status]
            )
            topic = "/accepted/manipulation_controller/requests"
            bag.write(topic, array, START + row * PERIOD)
    run = Run(tmp_path / "bag")
    sections = [*run.earlier, run]
    assert [len(each.record) for each in sections] == [30, 12]
    np.testing.assert_array_equal(run.earlier[0].record.theta, first.theta)
    assert [each.key for one in sections for each in one.requests] == ["grasp", "reset"]
    assert "a user calls grasp (false)" in [event.text for event in run.earlier[0].events]
    document = Parts(write_report(run, tmp_path).read_text()).document
    assert [each["ticks"] for each in document["runs"]] == [30, 12]


def test_runs_are_labelled_by_what_differs(tmp_path: Path) -> None:
    runs = []
    for mode in ("auto", "user"):
        text = resolved(load_scenario("pull", {"slip_regulator.mode": mode}))
        told = {"scenario": text}
        runs.append(Run(write_record(tmp_path / mode, random_record(20), custom_data=told)))
    assert differing(runs) == [["slip_regulator.mode", "auto", "user"]]
    assert labels(runs) == ["pull (mode=auto)", "pull (mode=user)"]
    assert labels([runs[0], runs[0]]) == ["pull (auto)", "pull (auto)"]


def test_a_gap_in_a_bag_is_a_gap_and_no_lost_contact(tmp_path: Path) -> None:
    record = random_record(60)
    record.contact_positions[20:30] = record.forces[20:30] = np.nan
    with RunWriter(tmp_path / "bag") as bag:
        for row in [*range(40), *range(50, 60)]:
            write_tick(bag, record, row, START + row * PERIOD, "/")
    run = Run(tmp_path / "bag")
    assert [(event.time, event.kind) for event in run.events if event.kind == "gap"] == [
        (0.038, "gap"),
        (0.078, "gap"),
    ]
    assert not [event for event in run.events if event.kind.startswith("contact")]
    assert run.metrics.contacts_lost_ticks == 0
    document = run_document(run)
    assert np.array(document["gaps"]) == pytest.approx(np.array([[0.038, 0.06], [0.078, 0.1]]))
    time, rates = values(document, "time"), values(document, "rates")
    assert np.isnan(rates[np.searchsorted(time, 0.078 - 1e-9)]).all()  # the line ends here
    assert np.isfinite(rates[-1]).all()


def unpack(packed):
    """Return the array that `pack` was given, rounded to its type."""
    data = base64.b64decode(packed["data"])
    return np.frombuffer(data, dtype=packed["type"]).reshape(packed["shape"])


def values(document: dict, name: str) -> np.ndarray:
    return unpack(document["columns"][name])


class TestDocument:
    def test_carries_the_arrays_of_the_run(self, run: Run) -> None:
        document, record = run_document(run), run.record
        np.testing.assert_array_equal(values(document, "time"), record.times)
        expected = scene_columns(record) | {
            "rates": record.rates,
            "force": record.forces,
            "expected": record.grasp_force[:, None] * record.optimal_forces[:, :, 1],
            "friction": record.friction,
            "squeeze": record.grasp_force,
            "beta": derived.required_friction(record),
            "latency": run.latencies,
        }
        for name, array in expected.items():
            np.testing.assert_array_equal(values(document, name), array.astype(np.float32), name)
        assert set(expected) < set(document["columns"])

    def test_carries_the_errors_of_the_pose(self, run: Run) -> None:
        document, record = run_document(run), run.record
        apart = np.linalg.norm(record.desired_position - record.auxiliary_position, axis=1)
        np.testing.assert_allclose(values(document, "position_error"), apart, rtol=1e-6)
        turned = np.linalg.norm(derived.rotation_error(record), axis=1)
        np.testing.assert_allclose(values(document, "rotation_error"), turned, rtol=1e-6)

    def test_of_a_long_run_shows_what_there_is_room_for(self, run: Run) -> None:
        whole = run_document(run)
        size = sum(unpack(column).nbytes for column in whole["columns"].values())
        part = run_document(run, room=size // 2)
        assert whole["shown"] == whole["ticks"] == part["ticks"] == 40
        assert part["shown"] < 40 and part["shown"] == len(values(part, "time"))
        assert part["tables"] == whole["tables"] and part["events"] == whole["events"]

    def test_of_a_real_hand_has_no_object(self, tmp_path: Path) -> None:
        run = Run(write_record(tmp_path / "bag", random_record(truth=False)))
        document = run_document(run)
        assert document["object"] is None and document["hand"] is None
        assert (
            document["passed"] is None and document["headline"] == "" and document["ledger"] == []
        )
        assert np.isnan(values(document, "object_position")).all()
        assert any("No scenario" in note for note in document["notes"])

    def test_of_a_scenario_has_hand_object_ledger_and_seed(self, tmp_path: Path) -> None:
        scenario = load_scenario("paper", {"seed": 7})
        told = {"scenario": resolved(scenario), "lost_messages": "3", "version_numpy": "2.4"}
        record = random_record(12)
        document = run_document(Run(write_record(tmp_path / "bag", record, custom_data=told)))
        solid = scenario.plant.object.solid()
        np.testing.assert_array_equal(document["object"]["vertices"], solid.vertices)
        assert [tip["finger"] for tip in document["hand"]["tips"]] == record.finger_names
        assert [line["name"] for line in document["ledger"]][:2] == ["A1", "A2"]
        rows = {row[0]: row[1] for table in document["tables"] for row in table["rows"]}
        assert rows["seed"] == "7" and rows["numpy"] == "2.4" and rows["messages lost"] == "3"
        assert document["scenario"] == resolved(scenario)

    def test_a_scenario_of_another_version_still_gives_the_object(self, tmp_path: Path) -> None:
        text = resolved(load_scenario("paper")) + "unheard_of: 1\n"
        bag = write_record(tmp_path / "bag", random_record(5), custom_data={"scenario": text})
        document = run_document(Run(bag))
        assert document["name"] == "paper" and document["object"] is not None
        assert document["ledger"] == [] and "does not fit" in document["notes"][0]


class TestTicks:
    def test_all_are_shown_where_they_fit(self) -> None:
        np.testing.assert_array_equal(shown(10, 10, [np.zeros(10)], np.array([3])), np.arange(10))

    def test_peaks_and_events_of_a_long_run_are_kept(self) -> None:
        signal = np.random.default_rng(1).normal(size=100_000)
        signal[[12_345, 54_321]] = 50.0, -50.0
        signal[70_000:80_000] = np.nan
        rows = shown(len(signal), 3000, [signal, -signal], np.array([777, 99_998]))
        assert 2900 < len(rows) <= 3010
        assert {0, 777, 12_345, 54_321, 99_998, 99_999} <= set(rows.tolist())
        assert (np.diff(rows) > 0).all() and np.diff(rows).max() < 100


def test_pack_keeps_numbers_and_what_is_unknown() -> None:
    array = np.array([[1.5, np.nan], [-2.0, 3.0e4]])
    for code in ("f4", "f8"):
        np.testing.assert_array_equal(unpack(pack(array, code)), array)
    np.testing.assert_array_equal(unpack(pack(np.array([0.0, 2.0, np.nan]), "u1")), [0, 2, 255])


class TestPage:
    def test_loads_nothing(self, run: Run) -> None:
        text = write_report(run).read_text(encoding="utf-8")
        parts = Parts(text)
        assert [load for load in parts.loads if not load[1].startswith("data:")] == []
        assert not {"iframe", "object", "embed", "img", "base"} & set(parts.tags)
        script = "".join(parts.texts["script"])
        assert len(script) > 100_000 and not re.search(CALLS, script)
        style = "".join(parts.texts["style"])
        assert "url(" not in style and "@import" not in style
        assert "default-src 'none'" in text and "connect-src" not in text

    def test_is_readable_as_json_whatever_a_bag_says(self, tmp_path: Path) -> None:
        evil = "</script><script>alert(1)</script><!-- \u2028 & \"'"
        scenario = load_scenario("paper").model_copy(update={"description": evil, "name": evil})
        told = {"scenario": resolved(scenario)}
        bag = write_record(tmp_path / "bag", random_record(5), custom_data=told)
        text = write_report(Run(bag)).read_text(encoding="utf-8")
        parts = Parts(text)
        assert parts.tags.count("script") == 2
        assert parts.document["runs"][0]["description"] == evil

    def test_of_ten_seconds_is_small(self, run: Run) -> None:
        record = random_record(5001)
        run.__dict__ |= {"record": record, "latencies": record.grasp_force}  # as if read
        assert run_document(run)["shown"] == 5001
        assert write_report(run).stat().st_size < 5_000_000

    def test_does_not_name_the_folder_of_the_run(self, run: Run, tmp_path: Path) -> None:
        assert str(tmp_path) not in write_report(run).read_text(encoding="utf-8")

    def test_cannot_be_written_over_a_folder(self, run: Run, tmp_path: Path) -> None:
        (tmp_path / "report.html").mkdir()
        with pytest.raises(TactileHandError, match="cannot be written"):
            write_report(run, tmp_path)

    def test_of_several_runs_has_each(self, run: Run, tmp_path: Path) -> None:
        other = Run(write_record(tmp_path / "other", random_record(30, seed=5)))
        file = write_comparison([run, other], tmp_path / "both.html")
        document = Parts(file.read_text(encoding="utf-8")).document
        assert document["kind"] == "comparison"
        assert [len(values(each, "time")) for each in document["runs"]] == [40, 30]


class TestCommands:
    def test_report_writes_beside_the_bag(
        self, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert cli.main(["report", str(tmp_path)]) == 0
        assert (tmp_path / "report.html").is_file()
        out = capsys.readouterr().out
        assert str(tmp_path / "report.html") in out.replace("\n", "") and " MB in " in out

    def test_compare_prints_metrics_side_by_side(
        self, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        bag = str(run.bag)
        assert cli.main(["compare", bag, bag, "--out", str(tmp_path / "out")]) == 0
        assert (tmp_path / "out" / "comparison.html").is_file()
        out = capsys.readouterr().out
        assert "1: " in out and out.count("(bag)") == 2 and "peak joint rate" in out

    @pytest.mark.parametrize("damage", ["missing", "cut", "no ticks", "alone"])
    def test_bad_input_is_one_sentence(
        self, damage: str, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        bad = tmp_path / "bad"
        arguments = ["report", str(bad)]
        if damage == "cut":
            whole = next(run.bag.glob("*.mcap")).read_bytes()
            bad = tmp_path / "bad.mcap"
            bad.write_bytes(whole[: len(whole) // 2])
            arguments = ["report", str(bad)]
        elif damage == "no ticks":
            with RunWriter(bad) as bag:
                bag.write("/other", joints(0, ["a"], position=[1.0]), 1)
        elif damage == "alone":
            arguments = ["compare", str(run.bag)]
        assert cli.main(arguments) == EXIT_REFUSED
        error = capsys.readouterr().err.strip()
        assert error.startswith("tactile-hand: ") and len(error.splitlines()) == 1
        assert not (bad.parent / "report.html").exists()
