# SPDX-License-Identifier: Apache-2.0
"""The command line of the orchestrator."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Any

import typer
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from rich.console import Console

from tactile_hand_ros.closed_loop.preflight import check_scenario
from tactile_hand_ros.closed_loop.scenario import Scenario, load_scenario
from tactile_hand_ros.config.model import parse_changes
from tactile_hand_ros.errors import ConfigurationError, TactileHandError
from tactile_hand_ros.jit.compiled import ensure_compiled
from tactile_hand_ros.orchestrator.claim import claim
from tactile_hand_ros.orchestrator.participation import first_line, graph_node, ros_context
from tactile_hand_ros.orchestrator.processes import Launcher
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, Session
from tactile_hand_ros.orchestrator.signals import Interrupted, Signals
from tactile_hand_ros.orchestrator.steering import how_to_steer
from tactile_hand_ros.orchestrator.view import make_view
from tactile_hand_ros.ros.realtime.scheduling import Scheduling, parse_cpus, parse_priority

EXIT_REFUSED = 2
_WIDTH = 100  # of tables in logs and pipes

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def orchestrate(
    context: typer.Context,
    scenario: Annotated[str, typer.Option(help="Scenario by name or YAML file.")] = "paper",
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Keep the hand alive until Ctrl-C.")
    ] = False,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time [s], instead of the scenario's.")
    ] = None,
    pacing: Annotated[
        str | None, typer.Option(help="lockstep or realtime, instead of the scenario's.")
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Another value, as plant.rate=250."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Where the runs are kept.")] = Path("runs"),
    record: Annotated[bool, typer.Option(help="Record a bag.")] = True,
    report: Annotated[bool, typer.Option(help="Write report.html of what was recorded.")] = True,
    composed: Annotated[
        bool | None,
        typer.Option(
            "--composed/--processes",
            help="Run all nodes in one process, or each in its own; by default one process in "
            "real time and several in lockstep.",
            show_default=False,
        ),
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of all nodes, as /left.")] = "",
    startup_timeout: Annotated[
        float, typer.Option(min=0.1, help="Longest wait for all nodes [s].")
    ] = 30.0,
    priority: Annotated[
        int, typer.Option(help="Priority of the nodes under SCHED_FIFO, 1 to 99; 0 for none.")
    ] = 0,
    cpus: Annotated[
        str, typer.Option(help="Processors for the nodes, as 0,2-3; not for the recorder.")
    ] = "",
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
) -> None:
    """Run a scenario: start the nodes, record them, command the poses, sum up.

    Exit code 0: the goal was reached and the bag is complete; 1: it was not, or something failed;
    2: the scenario was refused and nothing was started; 130, 143: ended by SIGINT, SIGTERM.
    """
    signals, ros_arguments = context.obj
    given = {"duration": duration, "plant.pacing": pacing}
    values = {key: value for key, value in given.items() if value is not None}
    launcher = Launcher()
    try:
        checked = _checked(scenario, {**values, **parse_changes(changes or [])})
        plan = Plan(
            scenario=checked,
            namespace=full_namespace(namespace, ros_arguments),
            record=record,
            interactive=interactive,
            composed=shares_process(checked, composed),
            startup_timeout=startup_timeout,
            scheduling=Scheduling(parse_priority(str(priority)), parse_cpus(cpus) if cpus else ()),
        )
        with (
            ros_context(ros_arguments) as ros,
            claim(ros.get_domain_id(), plan.namespace) as held,
        ):
            signals.check()
            directory = RunDirectory.create(out, plan.scenario.name)
            session = Session(plan, directory, launcher, signals, held)
            joining = graph_node(ros, plan.namespace)
            where = "" if composed is not None else _default_place(plan)
            raise typer.Exit(_run(session, joining, where, quiet=quiet, report=report))
    except TactileHandError as error:
        print(error, file=sys.stderr)
        raise typer.Exit(EXIT_REFUSED) from None


def _checked(name: str, changes: dict[str, Any]) -> Scenario:
    """Load a scenario and make sure that it can work."""
    scenario = load_scenario(name, changes)
    check_scenario(scenario)
    # Where nothing has been compiled yet this takes long; the plant would miss its deadline.
    ensure_compiled()
    return scenario


def shares_process(scenario: Scenario, composed: bool | None) -> bool:
    """Return whether the nodes share a process: as asked for, else in real time."""
    return scenario.plant.pacing == "realtime" if composed is None else composed


def _default_place(plan: Plan) -> str:
    """Return a line that says where the nodes run, empty where that is nothing special."""
    if not plan.composed:
        return ""
    return "real time: the nodes share one process; --processes gives each node its own"


def full_namespace(given: str, ros_arguments: Sequence[str]) -> str:
    """Return the namespace of the run with a leading slash, ``/`` if there is none.

    Args:
        given: The option, empty if not used.
        ros_arguments: Command line that may remap ``__ns``.

    Raises:
        ConfigurationError: If it is no ROS namespace.
    """
    remapped = [word.partition("__ns:=")[2] for word in ros_arguments if "__ns:=" in word]
    name = "/" + (given or (remapped[-1] if remapped else "")).strip("/")
    if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", name):
        raise ConfigurationError(
            f"the namespace is '{given or remapped[-1]}', expected names of letters, digits and _ "
            "joined by /, such as /left"
        )
    return name


def _run(
    session: Session,
    joining: AbstractContextManager[Node],
    where: str,
    *,
    quiet: bool,
    report: bool,
) -> int:
    """Run a session, judge it and show what came out.

    Args:
        session: The run.
        joining: Provides the orchestrator's own node.
        where: A line that says where the nodes run; empty for none.
        quiet: Whether to show no progress.
        report: Whether to write the page.
    """
    plan, directory = session.plan, session.directory
    console = Console(width=None if sys.stdout.isatty() else _WIDTH)

    def tell(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    tell(f"{plan.scenario.name}: {plan.scenario.description}")
    if where:
        tell(where)
    tell(f"the nodes start; what they say is in {directory.path / 'logs'}")
    if plan.interactive:
        tell(f"Ctrl-C ends the run. To move the hand: {how_to_steer(plan.namespace)}")
    duration = None if plan.interactive else plan.scenario.duration
    outcome = session.run(joining, make_view(console, duration, quiet=quiet))
    # Not before: reading bags takes a tenth of a second to load, and the hand would wait for it.
    from tactile_hand_ros.orchestrator import summary

    results = summary.read_results(plan, directory, finished=outcome.is_complete)
    verdict = summary.judge(plan, outcome, results, session.signals.exit_code)
    summary.write_summary(plan, directory, outcome, results, verdict)
    if results.metrics:
        console.print(summary.table(plan, outcome, results))
    deadlines = summary.deadlines_of(plan, outcome)
    if deadlines is not None and deadlines.too_slow:
        tell(deadlines.too_slow)
    if report and (line := summary.report_line(results)):
        tell(line)
    tell(f"{verdict.outcome}; everything is in {directory.path}")
    for reason in verdict.reasons:
        print(reason, file=sys.stderr)
    return verdict.exit_code


def run(args: Sequence[str] | None, signals: Signals) -> int:
    """Run the command line and return the exit code.

    Args:
        args: Command line with program name; None takes ``sys.argv``.
        signals: Installed already.
    """
    line = list(sys.argv if args is None else args)
    command = typer.main.get_command(app)
    try:
        own, ros_arguments = split_ros_arguments(line)
        command(args=own, prog_name="orchestrator", obj=(signals, ros_arguments))
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except Interrupted:
        return signals.exit_code
    except ConfigurationError as error:
        print(error, file=sys.stderr)
        return EXIT_REFUSED
    return 0


def split_ros_arguments(line: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split a command line with program name into our own arguments and a line for rclpy.

    Raises:
        ConfigurationError: If the ROS arguments are malformed.
    """
    try:
        own = remove_ros_args(list(line))[1:]
    except RuntimeError as error:
        raise ConfigurationError(f"the ROS arguments cannot be used: {first_line(error)}") from None
    return own, list(line) if "--ros-args" in line else []
