# SPDX-License-Identifier: Apache-2.0
"""Numbers as text: with units, without insignificant digits, and unknown for NaN."""

import math
from dataclasses import replace

import pytest

from tactile_hand_ros.cli.output import print_table
from tactile_hand_ros.report import tables
from tactile_hand_ros.run.assumptions import Assumption
from tactile_hand_ros.run.metrics import Metrics
from tactile_hand_ros.run.recording import BagMetrics, TopicCount

METRICS = Metrics(
    ticks=500,
    simulated_time_s=1.0,
    final_position_error_m=0.0012345,
    final_rotation_error_rad=0.02,
    settling_time_s=0.5,
    peak_joint_rate_rad_per_s=2.5,
    final_grasp_force_N=10.0,
    final_normal_forces_N={"a": 5.0, "b": 3.0},
    optimal_normal_forces_N={"a": 4.0, "b": math.nan},
    worst_normal_force_relative_error=0.25,
    normal_force_sum_N=8.0,
    normal_force_sum_relative_error=0.2,
    peak_normal_force_N=6.0,
    final_required_friction={"a": 0.1, "b": 0.2},
    max_required_friction={"a": 0.3, "b": 0.4},
    contacts_lost_ticks=3,
    first_contact_loss_s=0.25,
    max_object_displacement_in_grasp_m=0.001,
    max_object_rotation_in_grasp_rad=0.01,
    max_slip_distance_m=0.002,
    slip_count=4,
    slip_alarm_count=5,
    dropped_at_s=math.nan,
    goal_reached=True,
)


def test_numbers_have_four_digits_and_lengths_are_in_thousandths() -> None:
    texts = [tables.number(1.23456, "N"), tables.number(12345.6), tables.number(math.nan, "N")]
    assert texts == ["1.235 N", "1.235e+04", "unknown"]
    lengths = [math.nan, 0.0, -0.99e-9, 1e-9, -0.99e-6, 1e-6, -0.0123456]
    milli = ["unknown", "0 mm", "0 mm", "< 0.001 mm", "< 0.001 mm", "0.001 mm", "-12.35 mm"]
    assert [tables.milli(length, "m") for length in lengths] == milli


def test_metrics_of_a_real_hand_that_dropped_the_object() -> None:
    """Unknown values are omitted, and so are those that only a held object has."""
    nan = math.nan
    dropped = replace(
        METRICS, dropped_at_s=0.75, max_object_rotation_in_grasp_rad=nan, max_slip_distance_m=nan,
        slip_count=None, goal_reached=None, contacts_lost_ticks=0, first_contact_loss_s=nan,
    )  # fmt: skip
    assert tables.metrics_rows(dropped) == [
        ["simulated time", "1 s in 500 ticks"],
        ["object", "dropped at 0.750 s"],
        ["peak joint rate", "2.5 rad/s"],
        ["beta of a, final / largest", "0.1 / 0.3"],
        ["beta of b, final / largest", "0.2 / 0.4"],
        ["ticks without a contact", "0"],
        ["slips, detected", "5"],
    ]
    rows = dict(tables.metrics_rows(replace(METRICS, goal_reached=False, normal_force_sum_N=nan,
                                            normal_force_sum_relative_error=nan)))  # fmt: skip
    assert (rows["goal"], rows["sum of f_n"]) == ("not reached", "unknown")


@pytest.mark.parametrize(
    ("share", "count", "text"),
    [
        (math.nan, 0, "not judged"),
        (1.0, 0, "throughout"),
        (0.9, 1, "90.0 %, violated from 1.00 to 1.50 s"),
        (0.5, 3, "50.0 %, violated from 1.00 to 1.50 s, 2.00 to 2.50 s, 3.00 to 3.50 s"),
        (0.5, 5, "50.0 %, violated from 1.00 to 1.50 s, 2.00 to 2.50 s, 3.00 to 3.50 s and 2 more"),
    ],
)
def test_when_an_assumption_held(share: float, count: int, text: str) -> None:
    broken = [(1.0 + i, 1.5 + i) for i in range(count)]
    line = Assumption("A1", "rigid", "travel", 0.5, math.nan, False, share, broken)
    assert tables.assumption_rows([line]) == [["A1", "rigid", "travel", "0.5", "none known", text]]
    limits = [replace(line, limit=2.0, below=below) for below in (True, False)]
    assert [row[4] for row in tables.assumption_rows(limits)] == ["< 2", "> 2"]


def test_how_complete_a_bag_is() -> None:
    counts = {"/a": TopicCount(9, 7, True), "/b": TopicCount(8, 6, False)}
    counts["/c"] = TopicCount(1, 1, None)
    bag = BagMetrics(99, counts, ["/d"], False, 2, 250.0, 0.001, 0.002, math.nan)
    assert tables.bag_rows(bag) == [
        ["messages", "99"],
        ["speed", "250 ticks/s"],
        ["command latency, median / p99 / longest", "1 ms / 2 ms / unknown"],
        ["ticks sent again", "2"],
        ["recording", "incomplete"],
        ["  /b", "6 ticks"],
        ["  /d", "absent"],
    ]
    assert ["recording", "complete"] in tables.bag_rows(replace(bag, complete=True))


def test_what_has_a_meaning_in_markdown_or_to_rich_is_text(capsys) -> None:
    text = tables.markdown(["x", "y"], [["a|b", "c"]])
    assert text == "| x | y |\n| --- | --- |\n| a\\|b | c |\n"
    print_table("[bold]", ["x"], [["[red]"]])
    assert {"[bold]", "[red]"} <= set(capsys.readouterr().out.split())


def test_a_table_in_the_terminal_has_a_head_where_its_columns_have_names() -> None:
    table = tables.rich_table("t", ["name", "verdict"], [["a", "[b]"]])
    assert table.show_header and [each.no_wrap for each in table.columns] == [False, True]
    assert list(table.columns[1].cells) == ["[b]"] and table.row_count == 1
    assert not tables.rich_table("t", ["", ""]).show_header
