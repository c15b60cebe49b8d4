# SPDX-License-Identifier: Apache-2.0
"""What the command line of the orchestrator does: check, prepare, run, judge and show."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import IO, cast

from rclpy.node import Node
from rich.console import Console

from tactile_hand_ros.command_line import LastingOutput, Signals, os_sentence
from tactile_hand_ros.compiled import ensure_compiled, is_complete
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.names import ORCHESTRATOR
from tactile_hand_ros.orchestrator.monitor import View
from tactile_hand_ros.orchestrator.options import RunOptions
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, Session
from tactile_hand_ros.orchestrator.steering import how_to_steer
from tactile_hand_ros.ros.middleware import full_namespace, graph_node, ros_context
from tactile_hand_ros.ros.scheduling import Scheduling, chosen_cpus, parse_priority
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

_WIDTH = 100  # of tables in logs and pipes


class OutputError(TactileHandError):
    """A run whose results could not be written or shown."""


class RunInProgressError(TactileHandError):
    """Another run is in progress in the same ROS domain and namespace."""


def execute(options: RunOptions, signals: Signals, ros_arguments: Sequence[str] = ()) -> int:
    """Run a scenario with these options, and return the exit code.

    Raises:
        TactileHandError: If it was refused; nothing was started.
        Interrupted: If a signal came before anything was started.
    """
    scenario, scheduling = _checked(options), _scheduling(options)
    # Where nothing has been compiled yet this takes long; the plant would miss its deadline.
    if not is_complete():
        print("compiling the numeric code, once; this takes a minute or two", file=sys.stderr)
    ensure_compiled()
    plan = Plan(
        scenario=scenario,
        namespace=full_namespace(options.namespace, ros_arguments),
        record=options.record,
        interactive=options.interactive,
        composed=shares_process(scenario, options.composed),
        separate_recorder=options.separate_recorder,
        startup_timeout=options.startup_timeout,
        scheduling=scheduling,
    )
    with (
        ros_context(ros_arguments) as ros,
        single_run_lock(ros.get_domain_id(), plan.namespace) as lock,
    ):
        signals.check()
        directory = RunDirectory.create(options.out, plan.scenario.name)
        session = Session(plan, directory, signals, lock)
        return _run(session, graph_node(ros, ORCHESTRATOR, plan.namespace), options)


def _scheduling(options: RunOptions) -> Scheduling:
    """Return how the nodes are to run."""
    cpus = chosen_cpus(options.cpus) if options.cpus else ()
    return Scheduling(parse_priority(str(options.priority)), cpus)


def _checked(options: RunOptions) -> Scenario:
    """Load a scenario and make sure that it can work."""
    own = {"duration": options.duration, "plant.pacing": options.pacing}
    given = {key: value for key, value in own.items() if value is not None}
    changes = parse_changes(options.changes)
    labels = {key: f"--set {key}" for key in changes}
    labels |= {key: f"--{key.rpartition('.')[2]}" for key in given}
    changes = {**given, **changes}
    scenario = load_scenario(options.wanted, changes, labels)
    check_scenario(scenario)
    return scenario


def shares_process(scenario: Scenario, composed: bool | None) -> bool:
    """Return whether the nodes share a process: by the option, otherwise in real time."""
    return scenario.plant.pacing == "realtime" if composed is None else composed


def _run(session: Session, joining: AbstractContextManager[Node], options: RunOptions) -> int:
    """Run a session, judge it and show the results."""
    plan, directory = session.plan, session.directory
    output = LastingOutput()
    console = Console(file=cast(IO[str], output), width=None if output.isatty() else _WIDTH)

    def show(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    show(f"{plan.scenario.name}: {plan.scenario.description}")
    if plan.composed and options.composed is None:
        show("real time: the nodes share one process; --processes gives each node its own")
    show(f"starting nodes; logs: {directory.path / 'logs'}")
    if plan.interactive:
        hint = how_to_steer(plan.namespace, plan.scenario.targets)
        show(f"Ctrl-C ends the run. To move the hand: {hint}")
    duration = None if plan.interactive else plan.scenario.duration
    outcome = session.run(joining, View(console, duration, quiet=options.quiet))
    # Imported late: it takes a tenth of a second, for which the hand would wait.
    from tactile_hand_ros.orchestrator import results

    start = time.monotonic()
    if plan.record and not options.quiet:
        show("reading the bag")
    found = results.read_results(plan, directory, finished=outcome.is_complete)
    verdict = results.judge(plan, outcome, found, session.signals.exit_code)
    results.write_summary(plan, directory, outcome, found, verdict)
    if found.run is not None:
        console.print(results.table(plan, outcome, found))
        if options.report:
            if not options.quiet:
                took = time.monotonic() - start  # of a long run, the report takes about as long
                show("writing the report" + (f", about {took:.0f} s" if took > 10.0 else ""))
            show(results.report_line(found.run))
    if options.open_report:
        show(results.open_report(directory))
    show(f"{results.in_words(verdict, found)}; results: {directory.path}")
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(*verdict.reasons, sep="\n", end="\n" * bool(verdict.reasons), file=sys.stderr)
    if output.problem is not None and not outcome.interrupted:
        raise OutputError(f"the results could not be shown: {os_sentence(output.problem)}")
    return verdict.exit_code


def single_run_lock(domain: int, namespace: str) -> socket.socket:
    """Lock a domain and namespace on this machine: a hand must not have two masters.

    The lock is a name among the abstract sockets. It ends with the last process that holds the
    socket, however that dies, and leaves no file behind.

    Args:
        domain: ROS domain id.
        namespace: Namespace of the run.

    Returns:
        The socket; it is the lock as long as a process holds it.

    Raises:
        RunInProgressError: If another run holds it.
    """
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    name = hashlib.sha256(f"{domain}{namespace}".encode()).hexdigest()  # of any length
    try:
        lock.bind(f"\0tactile_hand_ros/{name}")
    except OSError as error:
        lock.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise RunInProgressError(
            f"a run is in progress in ROS domain {domain} and namespace '{namespace}'; stop it, or"
            " give this one another --namespace or ROS_DOMAIN_ID"
        ) from None
    return lock
