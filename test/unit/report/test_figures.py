# SPDX-License-Identifier: Apache-2.0
"""Figures can be drawn of every record, even of failed runs."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from support.recorded import random_record

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.report.figures import friction_figure, motion_figure
from tactile_hand_ros.report.page import Result
from tactile_hand_ros.report.scene import grasp_figure
from tactile_hand_ros.report.style import AXES, DPI, PAGE, finger_color, save
from tactile_hand_ros.scenario.scenario import load_scenario


def lost(record: Record) -> Record:
    """Drop the object half-way."""
    half = len(record) // 2
    for array in (record.contact_positions, record.contact_quaternions, record.optimal_forces):
        array[half:] = np.nan
    record.auxiliary_position[half:] = record.auxiliary_quaternion[half:] = np.nan
    record.forces[half:] = 0.0  # fingers without contact measure zero
    return record


GOOD = random_record()


def figures(record: Record) -> list[Figure]:
    fig2 = grasp_figure(record, load_scenario("paper"))
    return [fig2, motion_figure(record), friction_figure({"one": record, "other": record})]


def test_figures_are_not_empty(tmp_path: Path) -> None:
    for number, figure in enumerate(figures(GOOD)):
        png, svg = save(figure, tmp_path, f"fig{number}")
        assert png.stat().st_size > 5000 and svg.stat().st_size > 5000
        with Image.open(png) as picture:
            assert abs(picture.width - PAGE * DPI) <= 1
            assert len(picture.convert("L").getcolors()) > 10


@pytest.mark.parametrize(
    "record", [random_record(truth=False), lost(random_record()), random_record(ticks=1)]
)
def test_every_record_can_be_drawn(record: Record) -> None:
    for figure in figures(record):
        figure.draw_without_rendering()


def test_lines_are_the_numbers_of_the_record() -> None:
    rates, position, _, forces = motion_figure(GOOD).axes
    for joint, line in enumerate(rates.lines):
        np.testing.assert_array_equal(line.get_ydata(), GOOD.rates[:, joint])
    for axis in range(3):
        actual, target = position.lines[2 * axis : 2 * axis + 2]
        np.testing.assert_array_equal(actual.get_ydata(), GOOD.auxiliary_position[:, axis])
        np.testing.assert_array_equal(target.get_ydata(), GOOD.desired_position[:, axis])
    np.testing.assert_array_equal(forces.lines[0].get_ydata(), GOOD.forces[1:, 0, 1])
    expected = GOOD.grasp_force * GOOD.optimal_forces[:, 0, 1]
    np.testing.assert_array_equal(forces.lines[1].get_ydata(), expected)


def test_a_rate_has_the_color_of_the_finger_that_its_joint_moves() -> None:
    """The thumb is this hand's first finger and has its last two joints."""
    hand = Hand.load("ability")
    record = Record.empty(5, hand.finger_names, hand.joint_names)
    record.stamps[:] = 2_000_000 * np.arange(5)
    record.rates[:] = np.arange(20.0).reshape(5, 4)

    def colors(figure: Figure) -> list[str]:
        return [line.get_color() for line in figure.axes[0].lines]

    expected = [finger_color(finger) for finger in (1, 2, 0, 0)]
    assert colors(Result(record, load_scenario("ability")).plot()) == expected
    assert colors(motion_figure(record, hand)) == expected
    assert colors(motion_figure(record)) == [finger_color(joint) for joint in range(4)]


def test_same_record_gives_same_files(tmp_path: Path) -> None:
    """Figures in the documentation change only with the numbers."""
    files = [save(motion_figure(GOOD), tmp_path / folder, "fig") for folder in "ab"]
    for one, other in zip(*files, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_no_color_means_two_things() -> None:
    fingers = {finger_color(i) for i in range(6)}
    assert len(fingers) == 6
    assert len({*AXES} | fingers) == 9


def test_strong_forces_stay_in_the_picture() -> None:
    scenario = load_scenario("paper", {"duration": 0.01, "targets": []})
    record = ClosedLoop(scenario).run()
    record.forces[:, 0] = (0.0, 240.0, 0.0)
    figure = grasp_figure(record, scenario)
    caption = next(text.get_text() for text in figure.texts if "mm per N" in text.get_text())
    length = float(caption.split("force on the object, ")[1].split(" mm")[0])
    assert 240.0 * length < 250.0  # mm, within the hand's reach
