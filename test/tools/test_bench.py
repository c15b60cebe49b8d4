# SPDX-License-Identifier: Apache-2.0
"""`make bench`: what it measures, saves and refuses; measured runs are real runs."""

import json

import pytest

from bench.__main__ import main
from bench.bare_loop import missed_by_bare_loop, wake_at_each_tick
from bench.graph import BenchError, run_graph
from bench.result import Measurement
from bench.wire import each_tick, rate
from bench.written import TickMessages, written_calls
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.scenario.scenario import NODES, load_scenario


def test_the_table_is_printed_and_saved(tmp_path, capsys):
    out = tmp_path / "results" / "bench.json"
    assert main(["--only", "blocks", "--ticks", "20", "--repeats", "1", "--out", str(out)]) == 0
    assert "controller, one tick" in capsys.readouterr().out
    saved = {each["name"]: each for each in json.loads(out.read_text())["results"]}
    assert saved["in-process, one plant step a tick"]["median"] > 0.0
    assert saved["controller, one tick"]["count"] == 20


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--rate", "500", "--rate", "0"], "Invalid value for '--rate'"),
        (["--only", "speed"], "Invalid value for '--only'"),
        (["--out", "."], "is a folder, expected a file name"),
        (["--seconds", "0"], "--seconds"),
    ],
)
def test_what_cannot_be_measured_is_refused(words, reason, capsys):
    assert main(["--only", "blocks", *words]) == 2
    printed = capsys.readouterr()
    assert reason in printed.err and "Traceback" not in printed.err and printed.out == ""


def test_a_result_is_judged_by_its_median():
    samples = [1.0, 2.0, 9.0]
    assert Measurement("", "", samples).verdict == ""
    assert Measurement("", "", samples, maximum=2.0).verdict == "pass"
    assert Measurement("", "", samples, minimum=2.1).verdict == "fail"
    assert Measurement("", "", [float("nan")], maximum=2.0).verdict == "fail"


def test_a_short_composed_run_is_measured():
    run = run_graph(0.2, "--composed")
    assert run["recording"]["ticks_per_second"] > 0.0 and run["wall_s"] > 0.2
    assert run["start_to_first_tick_s"] > 0.0


def test_a_run_that_is_refused_is_an_error_with_its_reason():
    with pytest.raises(BenchError, match="no_such"):
        run_graph(0.2, "--set", "plant.no_such=1")


def test_the_loop_writes_each_message_of_a_tick():
    loop = ClosedLoop(load_scenario("paper"))
    messages = TickMessages(loop.run(1))
    written = (*messages.of(0), *messages.carried(0, loop.regulator.carried))
    assert {topic for topic, *_ in written} == {link.topic for link in each_tick()}


def test_ticks_go_round_by_messages_alone():
    assert rate((",".join(NODES[:2]), ",".join(NODES[2:])), 20, recorded=False) > 0.0


def test_the_in_process_loop_can_write_a_bag():
    assert written_calls(load_scenario("paper"), 20) > 0.0


def test_a_bare_loop_counts_every_tick_once():
    ticks, missed = wake_at_each_tick(1000.0, 0.2)
    assert 200 <= ticks <= 201 + missed
    assert 0.0 <= missed_by_bare_loop(200.0, 0.2) <= 1.0
