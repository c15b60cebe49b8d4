# SPDX-License-Identifier: Apache-2.0
"""A recorded run, recomputed: identical, or the first different tick is named."""

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.messages import force_message, pose_message
from support.outcomes import run_with
from support.recorded import (
    PERIOD,
    START,
    RunWriter,
    parameter_event,
    request_message,
    write_run,
    write_tick,
)

from tactile_hand_ros.cli import main
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.control.laws import OWN_LAWS, Target
from tactile_hand_ros.control.slip.regulator import SlipRegulator
from tactile_hand_ros.errors import BagError
from tactile_hand_ros.hand.joints import Joints
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, resolved
from tactile_hand_ros.verify.recompute import ShadowLoop, compare, recompute
from tactile_hand_ros.verify.recorded_inputs import read_inputs

TICKS = 251
TICK = 2_000_000  # ns
GRIP = {
    "duration": 0.5,
    "plant.rate": 500.0,
    "user_forces": [{"time": 0.2, "force": 3.0}, {"time": 0.3, "force": 15.0}],
    "targets": [{"time": 0.0, "position": [0.0, 0.05, 0.4]}],
}


@pytest.fixture(scope="module")
def paper() -> tuple[Scenario, Record]:
    """Return the first quarter of a second of the paper's run."""
    scenario = load_scenario("paper", {"duration": 0.25})
    return scenario, ClosedLoop(scenario).run()


@pytest.fixture(scope="module")
def gravity() -> tuple[Scenario, Record]:
    """Return a run with all features of the controllers: cones, observer, reference, user."""
    scenario = load_scenario("user_grip", GRIP)
    return scenario, ClosedLoop(scenario).run()


def write(folder: Path, scenario: Scenario, record: Record, *changes: tuple[int, str, Any]) -> Run:
    """Write a bag like the recorder, with further messages given by row, topic and content."""
    with RunWriter(folder / "bag", {"scenario": resolved(scenario)}) as bag:
        write_run(bag, scenario, record)
        for user in scenario.user_forces:
            row = int(np.searchsorted(record.stamps, user.stamp))
            force = force_message((0.0, user.force, 0.0), user.stamp)
            bag.write("/accepted/user_grasp_force", force, START + row * PERIOD + 1)
        for row, topic, content in changes:
            bag.write(f"/accepted/{topic}", content, START + row * PERIOD + 1)
    return Run(folder)


def test_same_configuration_gives_the_same_bits(gravity, tmp_path):
    result = recompute(write(tmp_path, *gravity))
    assert [c for c in result if not c.same] == []
    assert all(c.compared == len(gravity[1]) > 100 for c in result)


def test_a_run_whose_driver_reports_no_torques_gives_the_same_bits(tmp_path):
    scenario = load_scenario("user_grip", GRIP)
    loop = ClosedLoop(scenario)
    answer = loop.chain.answer
    loop.chain.answer = lambda stamp, joints, *touch: answer(
        stamp, joints._replace(applied=None), *touch
    )
    record = loop.run()
    record.torque[:] = np.nan
    result = recompute(write(tmp_path, scenario, record))
    assert [c for c in result if not c.same] == []
    assert all(c.compared == len(record) for c in result)


def test_first_tick_that_differs_is_named(paper, tmp_path):
    scenario, record = paper
    record = copy.deepcopy(record)
    record.command[123, 4] = np.nextafter(record.command[123, 4], np.inf)
    result = recompute(write(tmp_path, scenario, record))
    [wrong] = [c for c in result if not c.same]
    assert (wrong.topic, wrong.first) == ("joint_command", int(record.stamps[123]))
    assert (wrong.compared, wrong.identical) == (len(record), len(record) - 1)
    assert 0.0 < wrong.largest < 1e-12


def test_the_regulator_feels_also_the_ticks_that_it_was_too_slow_to_answer(gravity, tmp_path):
    scenario, record = gravity[0].changed({"plant.pacing": "realtime"}), copy.deepcopy(gravity[1])
    for name in ("grasp_force", "friction", "slip_evidence", "grip"):
        getattr(record, name)[50:53] = np.nan
    result = recompute(write(tmp_path, scenario, record))
    grasp = next(c for c in result if c.topic == "grasp_force")
    assert grasp.same and grasp.compared == len(record) - 3


def test_a_request_ends_what_a_slip_in_normal_forces_has_raised(gravity, tmp_path):
    scenario, record = gravity[0], copy.deepcopy(gravity[1])
    slides = (np.arange(TICKS) >= 60) & (np.arange(TICKS) < 80)
    noise = np.where(slides, 0.5, 0.005)[:, None] * np.random.default_rng(4).normal(size=(TICKS, 3))
    record.forces[:], record.forces[:, :, 1] = np.nan, 5.0 + noise
    regulator = SlipRegulator(scenario.slip_regulator)
    for row, stamp in enumerate(record.stamps.tolist()):
        for user in scenario.user_forces:
            if user.stamp == stamp:
                regulator.request(user.force)
        joints = Joints(record.theta[row], record.rates[row], record.torque[row])
        contacts = Contacts.from_poses(
            record.contact_positions[row], record.contact_quaternions[row]
        )
        record.grasp_force[row] = regulator.step(stamp, joints, contacts, record.forces[row])
    assert record.grasp_force[99] > 1.2 * record.grasp_force[59]
    assert record.grasp_force[140] < record.grasp_force[99]
    result = recompute(write(tmp_path, scenario, record))
    assert next(c for c in result if c.topic == "grasp_force").same


def without_touch(scenario: Scenario, record: Record, held: tuple, silent: tuple) -> Record:
    """Return a run without the forces of some ticks, during which it held or did not answer."""
    out = copy.deepcopy(record)
    controller = Controller(scenario.manipulation_controller)
    regulator = SlipRegulator(scenario.slip_regulator)
    for target in scenario.targets:
        controller.targets.command(target.target(), target.stamp)
    answers = ("forces", "grasp_force", "friction", "slip_evidence", "grip", "command")
    for row, stamp in enumerate(record.stamps.tolist()):
        joints, forces = Joints(record.theta[row], record.rates[row]), record.forces[row]
        touch = record.contact_positions[row], record.contact_quaternions[row]
        contacts = Contacts.from_poses(*touch)
        if row in held + silent:
            for name in (*answers, "auxiliary_position", "auxiliary_quaternion"):
                getattr(out, name)[row] = np.nan
            if row in held:
                out.command[row] = controller.hold(joints, "no forces").torque
            continue
        out.grasp_force[row] = regulator.step(stamp, joints, contacts, forces)
        out.friction[row], out.grip[row] = regulator.learned_friction, regulator.state
        out.slip_evidence[row] = regulator.slip_likelihood
        f, k_f = record.optimal_forces[row], float(out.grasp_force[row])
        out.command[row] = controller.step(stamp, joints, contacts, f, k_f).torque
    return out


def test_a_run_that_held_for_lack_of_touch_is_held_again(paper, tmp_path):
    """If it did not answer at all, the recomputed one does not either."""
    scenario, record = paper[0], paper[1].part(slice(40))
    missed = without_touch(scenario, record, held=(10, 11, 30), silent=(20,))
    assert (missed.command[[10, 30]] != record.command[[10, 30]]).all()
    result = recompute(write(tmp_path, scenario, missed))
    assert [c.topic for c in result if not c.same] == []
    compared = {c.topic: c.compared for c in result}
    assert (compared["joint_command"], compared["grasp_force"]) == (39, 36)
    assert compared["optimal_force"] == 40


def test_cones_of_a_shadow_follow_the_friction_that_it_learns_itself(tmp_path):
    """They are so narrow that they shape f*."""
    changes = GRIP | {"slip_regulator.reflex.margin": 4.0, "user_forces": []}
    scenario = load_scenario("user_grip", changes)
    run = write(tmp_path, scenario, ClosedLoop(scenario).run(40))
    assert all(c.same for c in recompute(run))
    other = read_inputs(run, scenario.changed({"slip_regulator.friction.prior": 0.6}))
    by_topic = {c.topic: c for c in compare(run.record, ShadowLoop(other).run())}
    assert by_topic["optimal_force"].identical < 10


def test_a_bag_cannot_import_a_law(tmp_path, monkeypatch, capsys):
    """A foreign bag may name any code; only laws named by the user are imported."""
    (tmp_path / "mine.yaml").write_text("extends: paper\nduration: 0.1\nlaw: foreign_law:Mine")
    law = "from tactile_hand_ros.control.laws import OptimalLaw as Mine"
    (tmp_path / "foreign_law.py").write_text(law)
    scenario = load_scenario(str(tmp_path / "mine.yaml"))
    run = write(tmp_path / "run", scenario, ClosedLoop(scenario).run())
    OWN_LAWS.clear()  # as in another process
    replay = ["replay", str(run.path), "--recompute"]
    assert main(replay) == 2
    assert "name it yourself: --law foreign_law:Mine" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    assert main([*replay, "--law", "foreign_law:Mine"]) == 0


def test_run_without_scenario_is_refused(paper, tmp_path):
    with RunWriter(tmp_path / "bag") as bag:
        write_tick(bag, paper[1], 0, START)
    with pytest.raises(BagError, match="configuration of .* is unknown"):
        recompute(Run(tmp_path))


LIVE: dict[str, dict[int, dict[str, Any]]] = {
    "slip_regulator": {60: {"reflex.margin": 0.3}, 180: {"mode": "user", "maximum": 30.0}},
    "force_optimizer": {90: {"weights": [5.0, 1.0, 8.0], "load_memory": 0.7}},
    "manipulation_controller": {
        70: {"law.k_p": 6.0, "law.damping": 0.1, "law.integral.k_p": 2.0},
        200: {"gravity_compensation": False, "law.integral.k_p": 0.0, "law.observer.time": 0.02},
    },
}
"""Live changes of parameters, by node and row."""


def test_live_parameters_count_from_their_tick_on(tmp_path):
    """All numbers to the bit; without the messages there is a difference."""
    scenario = load_scenario("user_grip", GRIP)
    loop, changes = ClosedLoop(scenario), {}
    events = []
    for node, rows in LIVE.items():
        values: dict[str, Any] = {}
        for row in (0, *rows):
            values = {**values, **rows.get(row, {})}
            event = parameter_event(row * TICK, node, values)
            events.append((row, f"{node}/parameters", event))
        block = getattr(loop, node.rpartition("_")[2])
        for row, live in rows.items():
            changes[row] = lambda block=block, to=live: block.configure(block.config.changed(to))
    record = run_with(loop, changes)
    run = write(tmp_path / "with", scenario, record, *events)
    assert [c for c in recompute(run) if not c.same] == []
    differing = {c.topic for c in recompute(run, "contact") if not c.same}
    assert differing == {"joint_command"}
    without = write(tmp_path / "without", scenario, record)
    wrong = {c.topic: c.first for c in recompute(without) if not c.same}
    assert {"grasp_force", "optimal_force", "joint_command"} <= wrong.keys()
    assert wrong["joint_command"] == wrong["optimal_force"] == 60 * TICK  # the margin


CALLS: dict[int, tuple[str, str, Callable[[Controller], None]]] = {
    30: ("reset", "", Controller.reset),
    60: ("grasp", "false", Controller.release),
    70: ("reset", "", Controller.forget),  # open fingers stay open
    80: ("grasp", "true", Controller.grasp),
    230: ("enable", "false", lambda controller: setattr(controller, "enabled", False)),
    240: ("enable", "true", lambda controller: setattr(controller, "enabled", True)),
}
"""Service calls and what they do, by row."""


def test_service_calls_count_from_their_tick_on(tmp_path):
    """A hand that only damps for a while, a reset, fingers that open and close on a new grasp."""
    scenario = load_scenario("user_grip", GRIP | {"gravity": [0.0, 0.0, 0.0]})
    loop, topic = ClosedLoop(scenario), "manipulation_controller/requests"
    calls = [(120, "slip_regulator/requests", request_message(120 * TICK, "", "reset"))]
    changes: dict[int, Callable[[], None]] = {120: loop.regulator.reset}
    for row, (name, value, call) in CALLS.items():
        calls.append((row, topic, request_message(row * TICK, "", name, value)))
        changes[row] = partial(call, loop.controller)
    record = run_with(loop, changes)
    drove = np.isfinite(record.auxiliary_position[:, 0])
    assert not drove[60:90].any() and drove[150:230].all()
    run = write(tmp_path / "with", scenario, record, *calls)
    assert [c for c in recompute(run) if not c.same] == []
    inputs = read_inputs(run, scenario)
    for node, found in inputs.changes.items():
        for i in (i for i in range(len(found)) if found[i].name in ("reset", "grasp", "enable")):
            rest = {**inputs.changes, node: [*found[:i], *found[i + 1 :]]}
            answered = ShadowLoop(replace(inputs, changes=rest)).run()
            assert not all(c.same for c in compare(run.record, answered)), found[i]


def test_poses_that_wait_and_overtake_each_other_are_followed_as_they_were(tmp_path):
    """Of two poses sent before the first grasp, the newer is out of reach: neither takes effect.

    A late one applies immediately, before a waiting one.
    """
    sent: list[tuple[int, int, list[float]]] = [
        (0, 0, [0.0, 0.05, 0.4]),
        (0, 0, [0.0, 0.5, 0.4]),
        (20, 200_000_000, [0.01, 0.04, 0.41]),
        (80, 100_000_000, [-0.01, 0.05, 0.4]),
    ]
    accepted: list[tuple[int, str, Any]] = []
    scenario = load_scenario("paper", {"duration": 0.5, "targets": []})
    loop, ticks = ClosedLoop(scenario), 110
    record = Record.empty(ticks, loop.plant.hand.finger_names, loop.plant.hand.joint_names)
    for row in range(ticks):
        for received, stamp, position in sent:
            if received == row:
                loop.controller.targets.command(Target(np.array(position), np.eye(3)), stamp)
        loop.tick(record, row)
        if loop.controller.targets.accepted is not None:
            position = loop.controller.targets.accepted.position
            pose = pose_message(position, (0.0, 0.0, 0.0, 1.0), row * TICK)
            accepted.append((row, "desired_pose", pose))
    assert [row for row, *_ in accepted] == [80, 100]
    run = write(tmp_path, scenario, record, *accepted)
    assert all(c.same for c in recompute(run))


def test_commands_tell_by_their_exit_code(paper, tmp_path, capsys):
    scenario, record = paper
    run = str(write(tmp_path / "good", scenario, record).path)
    assert main(["replay", run, "--recompute"]) == 0
    assert main(["replay", run, "--recompute", "--law", "kawamura"]) == 1
    record = copy.deepcopy(record)
    record.grasp_force[9] += 1.0
    assert main(["replay", str(write(tmp_path / "bad", scenario, record).path), "--recompute"]) == 1
    assert "The answers differ" in capsys.readouterr().err
    assert main(["replay", run, "--recompute", "--law", "kawamuro"]) == 2
