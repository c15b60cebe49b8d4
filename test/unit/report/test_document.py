# SPDX-License-Identifier: Apache-2.0
"""The document of a page: one run field by field, and special cases of other runs.

`PYTHONPATH=test python test/unit/report/test_document.py` rewrites the expected document.
"""

import base64
import json
import re
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from std_msgs.msg import String
from support.messages import joint_message
from support.recorded import (
    PERIOD,
    START,
    RunWriter,
    random_record,
    request_message,
    write_record,
    write_tick,
)

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.report.document import run_document, shown
from tactile_hand_ros.report.page import MOST_EARLIER, Result, write_report
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, resolved

GOLDEN = Path(__file__).parents[2] / "data" / "report.json"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
PULL = [{"kind": "step", "start": 0.02, "force": [0.0, 0.0, -2.0]}]


def pulled() -> tuple[Scenario, Any]:
    """Return a short run with a pull on the object, and its record."""
    scenario = load_scenario("paper", {"duration": 0.06, "plant.disturbances": PULL})
    return scenario, ClosedLoop(scenario).run()


def recorded_run(folder: Path) -> Run:
    scenario, record = pulled()
    told = {"scenario": resolved(scenario), "lost_messages/clock": "2", "version_numpy": "2.4"}
    return Run(write_record(folder / "bag", record, custom_data=told))


def unpack(column: dict[str, Any]) -> NDArray[np.float64]:
    data = np.frombuffer(base64.b64decode(column["data"]), dtype="<" + column["type"])
    return data.reshape(column["shape"]).astype(np.float64)


def values(document: dict[str, Any], name: str) -> NDArray[np.float64]:
    return unpack(document["columns"][name])


def readable(document: dict[str, Any]) -> Any:
    """Return a document as in JSON, with some rows of its arrays as numbers."""
    out = dict(document)
    out["columns"] = {
        name: {"shape": column["shape"], "rows": unpack(column)[[0, 1, 15, -1]].tolist()}
        for name, column in document["columns"].items()
    }
    return json.loads(json.dumps(json_ready(out)))


def assert_same(found: Any, expected: Any) -> None:
    """Assert that plain data are equal, numbers to a millionth."""
    texts = [json.dumps(each, indent=0, sort_keys=True) for each in (found, expected)]
    assert NUMBER.sub("#", texts[0]) == NUMBER.sub("#", texts[1])
    # Residuals at rounding level differ between machines.
    numbers = [np.array(NUMBER.findall(text), dtype=float) for text in texts]
    np.testing.assert_allclose(*numbers, rtol=1e-6, atol=1e-9)


def test_the_document_of_a_recorded_run(tmp_path: Path) -> None:
    assert_same(readable(run_document(recorded_run(tmp_path))), json.loads(GOLDEN.read_text()))


def test_a_simulated_run_gives_the_same_without_what_only_a_bag_holds(tmp_path: Path) -> None:
    scenario, record = pulled()
    result = Result(record, scenario)
    of_bag = readable(run_document(recorded_run(tmp_path)))
    found = readable(run_document(result))
    for name in ("recorded", "tables", "tiles", "columns", "scenario"):
        del of_bag[name]
    assert_same({name: found[name] for name in of_bag}, of_bag)
    assert found["tiles"][-1]["label"] == "longest slip"
    assert found["tables"][0]["title"] == "Metrics"
    assert result.report(tmp_path) == tmp_path / "report.html"
    assert len(result.plot().axes) == 4


def test_of_a_long_run_shows_peaks_and_what_there_is_room_for(tmp_path: Path) -> None:
    record = random_record(500)
    record.rates[101, 1] = -99.0
    record.grasp_force[407] = 99.0
    record.forces[:] = (0.1, 5.0, 0.0)
    record.forces[233, 0] = (99.0, 5.0, 0.0)
    record.contact_positions[:, 1] = record.forces[:, 1] = np.nan  # it never touches
    run = Run(write_record(tmp_path / "bag", record))
    whole = run_document(run)
    size = sum(unpack(column).nbytes for column in whole["columns"].values())
    part = run_document(run, room=size // 20)
    assert whole["shown"] == whole["ticks"] == part["ticks"] == 500 > 4 * part["shown"]
    assert len(values(part, "time")) == part["shown"]
    assert values(part, "rates").min() == -99.0 and values(part, "grasp_force").max() == 99.0
    assert np.nanmax(values(part, "beta")) == pytest.approx(99.0 / 5.0)
    assert part["tables"] == whole["tables"] and part["events"] == whole["events"]


@pytest.mark.parametrize("limit", [5, 8, 20, 60, 99])
def test_of_many_ticks_first_last_peaks_and_events_are_shown(limit: int) -> None:
    up, down = np.zeros(100), np.zeros(100)
    up[37], down[61], up[3] = 5.0, -5.0, np.nan
    rows = shown(100, limit, [up, down], np.array([42]))
    assert {0, 37, 42, 61, 99} <= set(rows.tolist()) and (np.diff(rows) > 0).all()
    assert len(rows) <= max(limit, 9) + 9


def test_a_gap_in_a_bag_is_a_gap_and_no_lost_contact(tmp_path: Path) -> None:
    """Before the first message nothing is drawn, so no line has to end there."""
    record = random_record(60)
    for dark in (slice(0, 8), slice(20, 30)):
        record.contact_positions[dark] = record.forces[dark] = np.nan
    with RunWriter(tmp_path / "bag") as bag:
        for row in [*range(40), *range(50, 60)]:
            write_tick(bag, record, row, START + row * PERIOD, "/")
    run = Run(tmp_path / "bag")
    assert not [event for event in run.events if event.kind.startswith("contact")]
    assert run.metrics.contacts_lost_ticks == 0
    document = run_document(run)
    assert np.array(document["gaps"]) == pytest.approx(np.array([[0.038, 0.06], [0.078, 0.1]]))
    time, rates = values(document, "time"), values(document, "rates")
    assert np.isnan(rates[np.searchsorted(time, 0.078 - 1e-9)]).all()  # the line ends here


def test_a_reset_begins_a_section_and_hides_nothing(tmp_path: Path) -> None:
    first, second = random_record(30, seed=2), random_record(12, seed=3)
    topic = "/accepted/manipulation_controller/requests"
    with RunWriter(tmp_path / "bag") as bag:
        for begin, record in ((0, first), (30, second)):
            for row in range(len(record)):
                write_tick(bag, record, row, START + (begin + row) * PERIOD, "/")
        for service, row in (("grasp", 5), ("reset", 31)):
            stamp = int((first if row < 30 else second).stamps[row % 30])
            asked = request_message(stamp, "", service, "false")
            bag.write(topic, asked, START + row * PERIOD)
    run = Run(tmp_path / "bag")
    np.testing.assert_array_equal(run.earlier[0].record.theta, first.theta)
    keys = [each.key for one in (*run.earlier, run) for each in one.requests]
    assert keys == ["grasp", "reset"]
    assert "a user calls grasp (false)" in [event.text for event in run.earlier[0].events]
    text = write_report(run, tmp_path).read_text(encoding="utf-8")
    assert '"ticks":30,' in text and '"ticks":12,' in text


def test_a_page_has_the_last_ten_sections(tmp_path: Path) -> None:
    """Even of a bag without any finger."""
    with RunWriter(tmp_path / "bag") as bag:
        for section in range(12):
            for tick in range(2 + section):
                state = joint_message(["a"], tick, position=[1.0])
                bag.write("/joint_states", state, START + (100 * section + tick) * 10**9)
    run = Run(tmp_path / "bag")
    assert [len(each.record) for each in run.earlier[-MOST_EARLIER:]] == list(range(4, 13))
    assert write_report(run).read_text(encoding="utf-8").count('"ticks":') == 10


def test_of_a_real_hand_has_no_object_and_nothing_judges_it(tmp_path: Path) -> None:
    document = run_document(Run(write_record(tmp_path / "bag", random_record(truth=False))))
    assert (document["object"], document["hand"], document["assumptions"]) == (None, None, [])
    assert (document["passed"], document["headline"]) == (None, "")
    assert np.isnan(values(document, "object_position")).all()
    assert any("The scenario is unknown" in note for note in document["notes"])
    labels = {tile["label"]: tile for tile in document["tiles"]}
    assert labels["slips"]["unit"] == "" and labels["recorded"]["note"] == "messages"


def test_a_dropped_object_is_the_headline(tmp_path: Path) -> None:
    record = random_record(40)
    record.contact_positions[20:, 1:] = record.contact_quaternions[20:, 1:] = np.nan
    record.true_positions[20:, 1:], record.forces[20:, 1:] = np.nan, 0.0
    document = run_document(Run(write_record(tmp_path / "bag", record)))
    assert document["tiles"][0]["label"] == "object dropped" and document["passed"] is False
    assert document["headline"] == "object dropped at 0.040 s"
    assert "dropped" in [event["kind"] for event in document["events"]]
    assert np.isnan(values(document, "position_error")[20:]).all()


def test_a_drop_is_shown_even_behind_more_contacts_than_a_page_lists() -> None:
    record = random_record(500, truth=False)
    record.contact_positions[1::2, 1] = np.nan  # lost and made in turn
    record.contact_positions[490:, 1:], record.forces[490:] = np.nan, 0.0
    result = Result(record, None)
    assert len(result.events) > 450
    document = run_document(result)
    shown, of_all = document["events"], [asdict(event) for event in result.events]
    assert len(shown) == 400 and shown == sorted(shown, key=lambda event: event["time"])
    assert shown[-1]["kind"] == "dropped" and shown[-1]["time"] == pytest.approx(0.98)
    assert shown[:399] == of_all[:399]


@pytest.mark.parametrize(
    ("old", "new", "words", "corners"),
    [
        ("name: paper", "name: paper\nunheard_of: 1", "The bag has neither the hand's URDF", 0),
        ("hand: paper", "a: [", "The bag has neither the hand's URDF", 0),
        ("hand: paper", "hand: gone/hand.yaml", "The hand cannot be drawn: ", 8),
        ("mesh: ''", "mesh: gone.stl", "The object cannot be drawn: gone", 0),
        ("shape: box", "shape: sphere", "", 614),
    ],
)
def test_of_another_machine_or_version_shows_what_fits(old, new, words, corners, tmp_path) -> None:
    """A scenario of another version of the package may have any content."""
    text = resolved(load_scenario("paper")).replace(old, new)
    run = Run(write_record(tmp_path / "bag", random_record(5), custom_data={"scenario": text}))
    document = run_document(run)
    assert document["scenario"] == text
    assert words in " ".join(document["notes"][-1:])
    is_unknown = "hand" in words
    assert (document["hand"] is None) == is_unknown == (document["assumptions"] == [])
    assert len((document["object"] or {"vertices": []})["vertices"]) == corners


def test_the_hand_that_was_recorded_is_drawn(tmp_path: Path) -> None:
    """Even if the scenario names another one."""
    urdf = (
        '<robot name="r"><link name="base"/><joint name="joint_1" type="revolute">'
        '<parent link="base"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>'
        '<link name="tip"/></robot>'
    )
    told = {"scenario": resolved(load_scenario("paper"))}
    with RunWriter(tmp_path / "bag", told) as bag:
        bag.write("/robot_description", String(data=urdf), START - 1)
        write_tick(bag, random_record(1), 0, START)
    tree = run_document(Run(tmp_path / "bag"))["hand"]
    assert [link["xyz"][0] for link in tree["links"]] == [0.0, 0.5]
    assert tree["tips"] == []


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        found = readable(run_document(recorded_run(Path(folder))))
    lines = [f'"{name}": {json.dumps(value)}' for name, value in found.items()]
    GOLDEN.write_text("{" + ",\n".join(lines) + "}\n")
