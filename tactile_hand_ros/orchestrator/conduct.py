# SPDX-License-Identifier: Apache-2.0
"""What the command line of the orchestrator does: check, prepare, run, judge and show."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import IO, cast

from rclpy.node import Node
from rich.console import Console

from tactile_hand_ros.command_line import LastingOutput, os_sentence
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.orchestrator.claim import claim
from tactile_hand_ros.orchestrator.participation import (
    check_environment,
    graph_node,
    ros_context,
)
from tactile_hand_ros.orchestrator.processes import Launcher
from tactile_hand_ros.orchestrator.request import Request
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, Session
from tactile_hand_ros.orchestrator.signals import Signals
from tactile_hand_ros.orchestrator.steering import how_to_steer
from tactile_hand_ros.orchestrator.view import make_view
from tactile_hand_ros.ros.scheduling import Scheduling, chosen_cpus, parse_priority
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario


class OutputError(TactileHandError):
    """A run whose results could not be written or shown."""


_WIDTH = 100  # of tables in logs and pipes


def conduct(
    request: Request, signals: Signals, ros_arguments: Sequence[str], launcher: Launcher
) -> int:
    """Run a scenario as asked, and return the exit code.

    Raises:
        TactileHandError: If it was refused; nothing was started.
        Interrupted: If a signal came before anything was started.
    """
    check_environment(os.environ)
    scenario, scheduling = _checked(request), _scheduling(request)
    # Where nothing has been compiled yet this takes long; the plant would miss its deadline.
    ensure_compiled()
    plan = Plan(
        scenario=scenario,
        namespace=full_namespace(request.namespace, ros_arguments),
        record=request.record,
        interactive=request.interactive,
        composed=shares_process(scenario, request.composed),
        separate_recorder=request.separate_recorder,
        startup_timeout=request.startup_timeout,
        scheduling=scheduling,
    )
    with ros_context(ros_arguments) as ros, claim(ros.get_domain_id(), plan.namespace) as held:
        signals.check()
        directory = RunDirectory.create(request.out, plan.scenario.name)
        session = Session(plan, directory, launcher, signals, held)
        return _run(session, graph_node(ros, plan.namespace), request)


def _scheduling(request: Request) -> Scheduling:
    """Return how the nodes are to run."""
    cpus = chosen_cpus(request.cpus) if request.cpus else ()
    return Scheduling(parse_priority(str(request.priority)), cpus)


def _checked(request: Request) -> Scenario:
    """Load a scenario and make sure that it can work."""
    own = {"duration": request.duration, "plant.pacing": request.pacing}
    options = {key: value for key, value in own.items() if value is not None}
    changes = {**options, **parse_changes(request.changes)}
    labels = {key: f"--{key.rpartition('.')[2]}" for key in options}
    scenario = load_scenario(request.wanted, changes, labels)
    check_scenario(scenario)
    return scenario


def shares_process(scenario: Scenario, composed: bool | None) -> bool:
    """Return whether the nodes share a process: as asked for, else in real time."""
    return scenario.plant.pacing == "realtime" if composed is None else composed


def full_namespace(given: str, ros_arguments: Sequence[str]) -> str:
    """Return the namespace of the run with a leading slash, ``/`` if there is none.

    Args:
        given: The option, empty if not used.
        ros_arguments: Command line that may remap ``__ns``.

    Raises:
        ConfigurationError: If it is not a ROS namespace.
    """
    remapped = [word.partition("__ns:=")[2] for word in ros_arguments if "__ns:=" in word]
    name = "/" + (given or (remapped[-1] if remapped else "")).strip("/")
    if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", name):
        raise ConfigurationError(
            f"the namespace is '{given or remapped[-1]}', expected names of letters, digits and _ "
            "joined by /, such as /left"
        )
    return name


def _run(session: Session, joining: AbstractContextManager[Node], request: Request) -> int:
    """Run a session, judge it and show what came out."""
    plan, directory = session.plan, session.directory
    output = LastingOutput()
    console = Console(file=cast(IO[str], output), width=None if output.isatty() else _WIDTH)

    def tell(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    tell(f"{plan.scenario.name}: {plan.scenario.description}")
    if plan.composed and request.composed is None:
        tell("real time: the nodes share one process; --processes gives each node its own")
    tell(f"the nodes start; what they say is in {directory.path / 'logs'}")
    if plan.interactive:
        tell(f"Ctrl-C ends the run. To move the hand: {how_to_steer(plan.namespace)}")
    duration = None if plan.interactive else plan.scenario.duration
    outcome = session.run(joining, make_view(console, duration, quiet=request.quiet))
    # Not before: reading bags takes a tenth of a second to load, and the hand would wait for it.
    from tactile_hand_ros.orchestrator.results import judgement, reading, report, summary, table

    results = reading.read_results(plan, directory, finished=outcome.is_complete)
    verdict = judgement.judge(plan, outcome, results, session.signals.exit_code)
    summary.write_summary(plan, directory, outcome, results, verdict)
    if results.metrics:
        console.print(table.table(plan, outcome, results))
    deadlines = reading.deadlines_of(plan, outcome)
    if deadlines is not None and deadlines.too_slow:
        tell(deadlines.too_slow)
    if request.report and (line := report.report_line(results)):
        tell(line)
    if request.open_report:
        tell(report.open_report(directory))
    tell(f"{judgement.told(verdict, results)}; everything is in {directory.path}")
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(*verdict.reasons, sep="\n", end="\n" * bool(verdict.reasons), file=sys.stderr)
    if output.problem is not None and not outcome.interrupted:
        raise OutputError(f"the results could not be shown: {os_sentence(output.problem)}")
    return verdict.exit_code
