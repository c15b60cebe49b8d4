# SPDX-License-Identifier: Apache-2.0
"""The steps of an orchestrator run: check, prepare, run, judge and show."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import IO, cast

from rich.console import Console

from tactile_hand_ros.command_line import LastingOutput, Signals
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.config.plain_yaml import parse_changes
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.names import ORCHESTRATOR
from tactile_hand_ros.orchestrator.monitor import View, line_console
from tactile_hand_ros.orchestrator.options import RunOptions
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome, Session
from tactile_hand_ros.ros.middleware import full_namespace, graph_node, ros_context
from tactile_hand_ros.ros.scheduling import parse_priority
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

_WIDTH = 100  # of tables in logs and pipes


def execute(
    options: RunOptions,
    signals: Signals,
    ros_arguments: Sequence[str] = (),
    companion: Callable[..., AbstractContextManager[None]] | None = None,
) -> int:
    """Run a scenario with these options, and return the exit code.

    `companion` makes a context around the run from its plan, its directory and the console. Raise
    TactileHandError for a rejected scenario, Interrupted after a signal, before anything starts.
    """
    scenario, priority = _checked(options), parse_priority(str(options.priority))
    # The first compilation takes long; during a run the plant would miss its deadlines.
    ensure_compiled(signals.wait)
    plan = Plan(
        scenario=scenario,
        namespace=full_namespace(options.namespace, ros_arguments),
        record=options.record,
        interactive=options.interactive,
        composed=shares_process(scenario, options.composed),
        startup_timeout=options.startup_timeout,
        priority=priority,
    )
    output = LastingOutput()
    console = line_console(cast(IO[str], output), width=None if output.isatty() else _WIDTH)
    # Release the lock before reading the results, so that the next run may start.
    with ros_context(ros_arguments) as ros, single_run_lock(ros.get_domain_id(), plan.namespace):
        signals.check()
        directory = RunDirectory.create(options.out, plan.scenario.name)
        _announce(plan, directory, options, console)
        duration = None if plan.interactive else plan.scenario.duration
        view = View(console, duration, quiet=options.quiet)
        joining = graph_node(ros, ORCHESTRATOR, plan.namespace)
        with companion(plan, directory, console) if companion else contextlib.nullcontext():
            outcome = Session(plan, directory, signals).run(joining, view)
    return _conclude(plan, directory, outcome, options, signals.exit_code, console)


def _checked(options: RunOptions) -> Scenario:
    """Load a scenario and check that it can work."""
    own = {"duration": options.duration, "plant.pacing": options.pacing}
    given = {key: value for key, value in own.items() if value is not None}
    scenario = load_scenario(options.wanted, {**given, **parse_changes(options.changes)})
    check_scenario(scenario)
    return scenario


def shares_process(scenario: Scenario, composed: bool | None) -> bool:
    """Return whether the nodes share a process: by the option, otherwise in real time only."""
    return scenario.plant.pacing == "realtime" if composed is None else composed


def _announce(plan: Plan, directory: RunDirectory, options: RunOptions, console: Console) -> None:
    """Announce the run."""
    show = functools.partial(console.print, soft_wrap=True)
    show(f"{plan.scenario.name}: {plan.scenario.description}")
    if plan.composed and options.composed is None:
        show("real time: the nodes share one process; --processes gives each node its own")
    show(f"starting nodes; logs: {directory.path / 'logs'}")
    if plan.interactive:
        show("Ctrl-C ends the run; steer it with `tactile-hand move`, `squeeze` or `release`")


def _conclude(
    plan: Plan,
    directory: RunDirectory,
    outcome: RunOutcome,
    options: RunOptions,
    signal_code: int,
    console: Console,
) -> int:
    """Judge a run, write and show its results, and return the exit code."""
    # Imported late: it takes 0.1 s, which would delay the start of the hand.
    from tactile_hand_ros.orchestrator import results

    show = functools.partial(console.print, soft_wrap=True)
    found = results.read_results(plan, directory, outcome)
    verdict = results.judge(plan, outcome, found, signal_code)
    try:
        results.write_summary(plan, directory, outcome, found, verdict)
    except OSError as error:  # the disk may be full
        reasons = [*verdict.reasons, f"summary.json cannot be written: {error.strerror}"]
        verdict = replace(verdict, reasons=reasons, exit_code=verdict.exit_code or 1)
    if found.metrics is not None and found.metrics.link_inside:
        show(f"warning: inside the object, which the simulation ignores: {found.metrics.link_note}")
    if found.run is not None:
        console.print(results.table(plan, outcome, found))
        if options.report:
            show(results.report_line(found.run))
    show(f"{results.in_words(verdict, found)}; results: {directory.path}")
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(*verdict.reasons, sep="\n", end="\n" * bool(verdict.reasons), file=sys.stderr)
    return verdict.exit_code


@contextlib.contextmanager
def single_run_lock(domain: int, namespace: str) -> Iterator[None]:
    """Lock a domain and namespace on this machine; raise TactileHandError if a run holds them.

    The lock is an abstract socket: the kernel removes it when this process exits, however it ends.
    """
    name = hashlib.sha256(f"{domain}{namespace}".encode()).hexdigest()  # of fixed length
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as lock:
        try:
            lock.bind(f"\0tactile_hand_ros/{name}")
        except OSError:
            raise TactileHandError(
                f"a run is in progress in ROS domain {domain} and namespace '{namespace}'; stop "
                "it, or give this one another --namespace or ROS_DOMAIN_ID"
            ) from None
        yield
