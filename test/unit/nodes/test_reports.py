# SPDX-License-Identifier: Apache-2.0
"""The diagnostics of nodes: facts of the last tick, and faults while they last."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from support.grasps import three_faces
from support.plants import plant

from tactile_hand_ros import names
from tactile_hand_ros.control.controller import Command, Mode
from tactile_hand_ros.control.laws import AuxiliaryPose, Target
from tactile_hand_ros.control.optimizer.force_optimizer import (
    ForceOptimizer,
    ForceOptimizerConfig,
    OptimalForces,
    Status,
)
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.control.slip.regulator import SlipRegulatorConfig
from tactile_hand_ros.nodes.common import ModeLog
from tactile_hand_ros.nodes.force_optimizer import OptimizerReport
from tactile_hand_ros.nodes.manipulation_controller import ControllerReport
from tactile_hand_ros.nodes.slip_regulator import GripState, RegulatorReport
from tactile_hand_ros.ros.diagnostics import ERROR, OK, WARN, Diagnostics

CONTACTS = three_faces()


def values(diagnostics: Diagnostics) -> dict[str, str]:
    return {pair.key: pair.value for pair in diagnostics.status().values}


def optimum() -> OptimalForces:
    optimizer = ForceOptimizer(ForceOptimizerConfig(), 3)
    return optimizer.solve(CONTACTS)._replace(solve_time=0.999999)


def test_ticks_without_an_answer_are_a_fault_with_their_reason_until_there_is_one():
    diagnostics, optimal = Diagnostics("node"), optimum()
    report = OptimizerReport(diagnostics)
    report.report()
    assert values(diagnostics)["unanswered_ticks"] == "0" and "status" not in values(diagnostics)
    none = optimal._replace(status=Status.UNBALANCED, reason="none")
    assert not none.ok
    for answer, level, message in (
        (none, ERROR, "none"),
        (none, ERROR, "none"),
        (none._replace(reason="other"), ERROR, "other"),
        (optimal, OK, "running"),
    ):
        report.note(answer)
        report.report()
        status = diagnostics.status()
        assert (status.level, status.message) == (level, message)
    shown = values(diagnostics)
    assert shown["unanswered_ticks"] == "3" and shown["status"] == optimal.status.value
    assert shown["solve_time_us"] == "999999"


def test_f_outside_the_usable_cones_at_most_ticks_is_told_with_the_worst_margin():
    """A short violation is no reason to warn."""
    diagnostics, optimal = Diagnostics("node"), optimum()
    report = OptimizerReport(diagnostics)
    depth = -0.07
    narrow, wide = (optimal._replace(cone_margin=margin) for margin in (depth, 0.2))
    for answers, warns in (
        ([narrow], True),
        ([narrow, wide, wide], False),
        ([narrow, narrow, wide], True),
        ([wide], False),
        ([narrow._replace(cone_margin=-1e-5)], False),  # on the edge
        ([optimal], False),
    ):
        for answer in answers:
            report.note(answer)
        report.report()
        status = diagnostics.status()
        assert status.level == (WARN if warns else OK)
        assert (f"margin {depth:.3g} per unit" in status.message) == warns


def made(mode: Literal["user", "shared", "auto"], needed: float = 5.0) -> Any:
    """Return the parts of a regulator that the report reads."""
    return SimpleNamespace(
        config=SlipRegulatorConfig(mode=mode, maximum=30.0),
        needed=needed,
        grasp_force=8.0,
        learned_friction=np.array([0.4, 0.5, 0.6]),
        slip_likelihood=np.array([0.1, 0.2, 0.3]),
        state=np.zeros(3, dtype=int),
    )


def noted(report: RegulatorReport, regulator: Any, *grips: tuple[int, int, int]) -> None:
    for number, grip in enumerate(grips):
        regulator.state = np.array(grip)
        state = GripState.of(regulator)
        report.note(regulator, 2_000_000 * number, CONTACTS, np.ones((3, 3)), state)


STUCK = (ContactState.STICK, ContactState.STICK, ContactState.STICK)


def test_facts_are_those_of_the_last_tick():
    diagnostics = Diagnostics("node")
    report = RegulatorReport(diagnostics, ["a", "b", "c"])
    regulator = made("auto")
    slip = int(ContactState.SLIP)
    noted(report, regulator, STUCK, (slip, 1, 0))
    report.report(regulator)
    shown = values(diagnostics)
    assert [shown[f"grip {name}"] for name in "abc"] == ["slip", "stick", "unknown"]
    assert [shown[f"friction {name}"] for name in "abc"] == ["0.4", "0.5", "0.6"]
    assert [shown[f"slip_evidence {name}"] for name in "abc"] == ["0.1", "0.2", "0.3"]
    assert (shown["mode"], shown["needed_force_n"], shown["grasp_force_n"]) == ("auto", "5", "8")


@pytest.mark.parametrize(
    ("mode", "needed", "limit", "shape"),
    [
        ("auto", 30.0, False, False),
        ("auto", 30.5, True, False),
        ("shared", 30.5, True, False),
        ("user", 30.5, False, False),
        ("auto", math.inf, False, True),
        ("user", math.inf, False, False),
    ],
)
def test_a_grasp_force_that_cannot_hold_is_a_warning(mode, needed, limit, shape):
    diagnostics = Diagnostics("node")
    report = RegulatorReport(diagnostics, ["a", "b", "c"])
    regulator = made(mode, needed)
    noted(report, regulator, STUCK, STUCK)
    report.report(regulator)
    shown = values(diagnostics)
    assert ("fault limit" in shown, "fault shape" in shown) == (limit, shape)
    assert diagnostics.status().level == (WARN if limit or shape else OK)
    if limit:
        assert "needs a grasp force of 30.5 N, but the limit is 30 N" in shown["fault limit"]
    regulator.needed = 5.0
    noted(report, regulator, STUCK)
    report.report(regulator)
    assert diagnostics.status().level == OK


def test_the_largest_required_grasp_force_is_reported_once():
    diagnostics = Diagnostics("node")
    report = RegulatorReport(diagnostics, ["a", "b", "c"])
    regulator = made("auto")
    for squeezes, told in (((90.0, 40.0), "90 N"), ((40.0, math.inf, 50.0), "50 N")):
        for regulator.needed in squeezes:
            noted(report, regulator, STUCK)
        report.report(regulator)
        assert f"needs a grasp force of {told}" in values(diagnostics)["fault limit"]


def controller_node() -> Any:
    """Return the parts of a node that its report reads, with lists of what it is told."""
    made = SimpleNamespace(diagnostics=Diagnostics("controller"), lines=[], rejected=[])
    made.get_logger = lambda: SimpleNamespace(info=made.lines.append)
    made.reject = lambda *rejection: made.rejected.append(rejection)
    return made


def command(mode: Mode, reason: str = "", pose: AuxiliaryPose | None = None) -> Command:
    return Command(np.zeros(9), mode, pose, reason)


def test_each_change_of_mode_is_a_line_and_a_hold_a_fault_while_it_lasts():
    node, state = controller_node(), plant().state
    report = ControllerReport(node, plant().hand)
    for said, level, contacts in (
        (command(Mode.DRIVE), OK, state.contacts),
        (command(Mode.HOLD, "no contact"), ERROR, state.contacts),
        (command(Mode.DRIVE), OK, state.contacts),
        (command(Mode.HOLD, "no touch"), OK, None),  # missing inputs are reported elsewhere
        (command(Mode.OPEN, "asked to"), WARN, state.contacts),
        (command(Mode.DISABLED, "asked to"), WARN, state.contacts),
        (command(Mode.DRIVE), OK, state.contacts),
    ):
        report.note(said, state.theta, contacts)
        assert node.diagnostics.status().level == level, said
    assert node.lines == [
        "drive -> hold: no contact",
        "hold -> drive",
        "drive -> hold: no touch",
        "hold -> open: asked to",
        "open -> disabled: asked to",
    ]  # no more than five per second
    assert node.rejected == []
    for _ in range(2):  # a pose for later that is out of reach when its time has come
        report.note(command(Mode.DRIVE, "out of reach"), state.theta, state.contacts)
    assert node.rejected == [(names.DESIRED_POSE, "out of reach")]


def test_each_change_is_one_line_with_its_reason_and_of_a_flood_five_a_second():
    lines: list[str] = []
    now = [7.0]
    log = ModeLog(lines.append, lambda: now[0])
    for mode, reason in (("drive", ""), ("drive", ""), ("hold", "no contact"), ("drive", "")):
        log.note(mode, reason)
    assert lines == ["drive -> hold: no contact", "hold -> drive"]
    ModeLog(lines.append).note("hold", "no touch yet")
    assert lines.pop() == "hold: no touch yet"
    for now[0], expected in ((7.999, 3), (8.0, 5), (8.999, 0), (9.0, 5)):
        lines.clear()
        for change in range(100):
            log.note("drive" if change % 2 else "hold", f"{change}")
        assert len(lines) == expected and lines[:1] in ([], ["drive -> hold: 0"])


def test_margins_are_those_of_the_grasp_and_unknown_without_one():
    node, state = controller_node(), plant().state
    report = ControllerReport(node, plant().hand)
    report.report(None)
    assert not any(key.startswith("A") for key in values(node.diagnostics))
    pose = AuxiliaryPose(np.array([0.1, 0.2, 0.3]), np.eye(3))
    target = Target(np.array([0.1, 0.5, 0.7]), np.eye(3))
    report.note(command(Mode.DRIVE, pose=pose), state.theta, state.contacts)
    report.report(None)
    assert "position_error_m" not in values(node.diagnostics)
    report.report(target)
    shown = values(node.diagnostics)
    assert (shown["mode"], shown["position_error_m"]) == ("drive", "0.5")
    assert shown["A1 face_travel_m"] == "0" and float(shown["A7 collinearity_margin"]) > 0.1
    assert float(shown["A5 joint_singularity_margin_m_per_rad"]) > 0.0
    report.note(command(Mode.HOLD, "no touch"), state.theta, None)
    report.report(target)
    shown = values(node.diagnostics)
    assert shown["A2 hemisphere_margin_rad"] == "nan"
    assert shown["mode"] == "hold" and shown["A7 collinearity_margin"] == "0"
