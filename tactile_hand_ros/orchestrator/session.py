# SPDX-License-Identifier: Apache-2.0
"""One run: start the nodes, wait until the graph is complete, command, watch, stop."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from rclpy.node import Node

from tactile_hand_ros.command_line import Interrupted, Signals, os_sentence
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.names import (
    COMPOSED,
    CONTROLLER,
    OPTIMIZER,
    ORCHESTRATOR,
    PLANT,
    RECORD,
    RECORDER,
    REGULATOR,
    SENSOR,
    USER_COMMANDS,
)
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.orchestrator.graph import GraphReadiness, MissingEndpoint
from tactile_hand_ros.orchestrator.monitor import Monitor, Rate, View
from tactile_hand_ros.orchestrator.processes import NodeDiedError, Processes
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.steering import Steering, SteeringError, UserForces
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.ros.scheduling import Scheduling
from tactile_hand_ros.scenario.scenario import Scenario

# After the recorder, which loads fast, what takes longest to load comes first.
START_ORDER = (RECORDER, PLANT, CONTROLLER, OPTIMIZER, REGULATOR, SENSOR)
STOP_ORDER = ((PLANT, COMPOSED), (SENSOR, REGULATOR, OPTIMIZER, CONTROLLER), (RECORDER,))

STALL = 15.0
"""Time without an answered tick after which a run is given up [s]."""

_LOOK = 0.02  # s between two looks at the nodes' messages
_FIRST_LOOK = 0.002  # s, while the first one is awaited
_GRAPH_LOOK = 0.03  # s between two looks at the graph
_REST = 1.0  # s, longest wait for the answers to the last tick
_LAST_HEARTBEATS = 0.3  # s, three of them: the recorder requests what it missed


class StartupError(TactileHandError):
    """The graph did not come together in time."""


class StallError(TactileHandError):
    """The plant gets no more answers."""


@dataclass(frozen=True)
class Plan:
    """What is to be run.

    Attributes:
        scenario: The scenario.
        namespace: Namespace of all nodes, ``/`` for none.
        record: Whether to record a bag.
        interactive: Whether to continue until a signal.
        composed: Whether the nodes share one process.
        separate_recorder: Whether the recorder has a process of its own also then.
        startup_timeout: Longest wait for the graph [s].
        scheduling: How the nodes are scheduled, all but the recorder: it may be late.
    """

    scenario: Scenario
    namespace: str = "/"
    record: bool = True
    interactive: bool = False
    composed: bool = False
    separate_recorder: bool = False
    startup_timeout: float = 30.0
    scheduling: Scheduling = Scheduling()

    @property
    def end(self) -> int | None:
        """Stamp of the last tick [ns], None for an endless run."""
        return None if self.interactive else (self.scenario.ticks - 1) * self.scenario.plant.tick

    def process(self, node: str) -> str:
        """Return the executable that a node runs in."""
        is_apart = node == RECORDER and self.separate_recorder
        return COMPOSED if self.composed and not is_apart else node


@dataclass
class RunOutcome:
    """How a run ended, as far as the orchestrator observed it.

    Attributes:
        failure: Why it ended early, empty if it did not.
        interrupted: Whether a signal ended it.
        complaints: A sentence for each process that did not end well.
        startup: Time since the start of the orchestrator at which each step was done [s].
        last_tick: Stamp of the last tick that was answered [ns], -1 for none.
        position_error: The last position error that was seen [m].
        plant: What the plant reported last, by key of its diagnostics.
    """

    failure: str = ""
    interrupted: bool = False
    complaints: list[str] = field(default_factory=list)
    startup: dict[str, float] = field(default_factory=dict)
    last_tick: int = -1
    position_error: float = float("nan")
    plant: dict[str, str] = field(default_factory=dict)

    @property
    def is_complete(self) -> bool:
        """Whether the run came to its last tick."""
        return not (self.failure or self.interrupted)

    def done(self, step: str) -> None:
        """Note that a step of the start is done."""
        self.startup[step] = round(_process_age(), 3)


class Session:
    """Runs a plan in a run directory.

    Attributes:
        plan: What is to be run.
        directory: Where everything is written.
        signals: Whether to stop.
        outcome: What became of it.
    """

    def __init__(
        self,
        plan: Plan,
        directory: RunDirectory,
        signals: Signals,
        lock: socket.socket,
    ) -> None:
        """Prepare.

        Args:
            plan: What is to be run.
            directory: Where everything is written.
            signals: Whether to stop.
            lock: Held as long as a process of the run may exist, and released after the run.
        """
        self.plan = plan
        self.directory = directory
        self.signals = signals
        self.outcome = RunOutcome()
        self.outcome.done("checked")
        self._lock = lock
        self._processes = Processes(lambda: signals.count > 1, lock)

    def run(self, joining: AbstractContextManager[Node], view: View) -> RunOutcome:
        """Run to the end, to a signal or to a failure; nothing is left running.

        Args:
            joining: Provides the orchestrator's own node, in the namespace of the run. It is made
                after the processes have been started, so that they do not wait for it.
            view: Shows the progress.
        """
        outcome = self.outcome
        with self._lock, self._processes, contextlib.ExitStack() as stack:
            try:
                self._start()
                self._command_and_watch(stack.enter_context(joining), view)
            except Interrupted:
                outcome.interrupted = True
            except TactileHandError as error:
                outcome.failure = str(error)
            except OSError as error:  # a full disk, for example
                outcome.failure = os_sentence(error)
            outcome.complaints = self._processes.stop(STOP_ORDER)
        return outcome

    def _start(self) -> None:
        """Start all processes, one right after the other: they load at the same time."""
        text = self.directory.write_scenario(self.plan.scenario)
        scheduling = self.plan.scheduling
        # The output of a node goes into its log here, not a second time below the home folder.
        common = ["--ros-args", "--disable-external-lib-logs"]
        if self.plan.namespace != "/":
            common += ["-r", f"__ns:={self.plan.namespace}"]
        for name, configs in self._groups(self._configs(text)).items():
            self.signals.check()
            files = [self.directory.write_parameters(*pair).resolve() for pair in configs.items()]
            parameters = [word for file in files for word in ("--params-file", str(file))]
            own = [] if name == RECORDER else list(scheduling.arguments)
            own += [RECORD] if name == COMPOSED and RECORDER in configs else []
            words = (*own, *common, *parameters)
            log, records = self.directory.log(name), RECORDER in configs
            self._processes.start(name, log, *words, records=records)
        self.outcome.done("processes_started")

    def _groups(self, configs: dict[str, Config]) -> dict[str, dict[str, Config]]:
        """Sort the nodes by the process they run in, in the order of the start."""
        groups: dict[str, dict[str, Config]] = {}
        for node in START_ORDER:
            if node in configs:
                groups.setdefault(self.plan.process(node), {})[node] = configs[node]
        return groups

    def _configs(self, scenario_text: str) -> dict[str, Config]:
        scenario = self.plan.scenario
        endless = {"duration": 0.0} if self.plan.interactive else {}
        configs: dict[str, Config] = {
            PLANT: scenario.plant.changed({"autostart": False, **endless}),
            SENSOR: scenario.tactile_sensor,
            REGULATOR: scenario.slip_regulator,
            OPTIMIZER: scenario.force_optimizer,
            CONTROLLER: scenario.manipulation_controller,
        }
        if self.plan.record:
            configs[RECORDER] = RecorderConfig(
                output=str(self.directory.bag.resolve()),
                topics=_recorded(self.plan.namespace),
                exclude=_not_recorded(self.plan.namespace),
                scenario=scenario_text,
            )
        return configs

    def _command_and_watch(self, node: Node, view: View) -> None:
        plan = self.plan
        steering = Steering(node, self._check)
        forces = UserForces(plan.scenario.user_forces, steering.grasp_force)
        closely = not plan.record or forces.is_due_later
        monitor = Monitor(node, plan.scenario.targets, closely=closely)
        self._await_graph(node, monitor, steering)
        steering.command(plan.scenario.targets)
        forces.step(0)
        self.outcome.done("targets_sent")
        steering.run(True)
        try:
            self._watch(monitor, view, forces)
        finally:
            self._come_to_rest(steering, monitor)

    def _await_graph(self, node: Node, monitor: Monitor, steering: Steering) -> None:
        """Wait until all nodes exist and have matched each other.

        Raises:
            StartupError: With what is missing and the last lines of the logs.
            NodeDiedError: If a process ended.
            DuplicateNodeError: If a node of the run exists twice.
        """
        plan = self.plan
        members = [PLANT, SENSOR, REGULATOR, OPTIMIZER, CONTROLLER, ORCHESTRATOR]
        if plan.record and plan.process(RECORDER) == RECORDER:
            members.append(RECORDER)
        readiness = GraphReadiness(node, members)

        def missing() -> Iterator[MissingEndpoint]:
            ours = {node.get_fully_qualified_name(): steering.facts}
            yield from readiness.missing({**monitor.facts(), **ours})
            if not steering.is_ready:
                yield MissingEndpoint(PLANT, "the service of the plant does not answer yet")

        end = time.monotonic() + plan.startup_timeout
        # The first missing endpoint is reason enough to wait: a search for all of them costs 5 %
        # of a processor while the nodes load.
        while next(missing(), None) is not None:
            self._processes.check()
            if time.monotonic() > end:
                raise StartupError(self._absence(list(missing())))
            self.signals.wait(_GRAPH_LOOK)
        self.outcome.done("graph_matched")

    def _absence(self, missing: Sequence[MissingEndpoint]) -> str:
        """Return what is missing first of each node, and what the logs contain."""
        first = {each.node: each.text for each in reversed(missing)}
        shown = "; ".join(first[name] for name in sorted(first))
        lines = [
            f"the graph is not complete after {self.plan.startup_timeout:g} s: {shown}; "
            f"look at {self.directory.path / 'logs'}"
        ]
        for name in dict.fromkeys(self.plan.process(each.node) for each in missing):
            tail = self._processes.tail(name)
            lines += [f"{name} | {line}" for line in tail] or [f"{name} has not printed anything"]
        return "\n".join(lines)

    def _watch(self, monitor: Monitor, view: View, forces: UserForces) -> None:
        """Follow the run to its last tick, and send the user forces that are due.

        Raises:
            Interrupted: After a signal.
            NodeDiedError: If a process ended.
            StallError: If no tick is answered any more.
        """
        outcome, end = self.outcome, self.plan.end
        rate = Rate(self.plan.scenario.plant.tick)
        progress = due = time.monotonic()
        with view.shown():
            while end is None or outcome.last_tick < end:
                self.signals.wait(_FIRST_LOOK if outcome.last_tick < 0 else _LOOK)
                self._processes.check()
                before, outcome.last_tick = outcome.last_tick, monitor.answered()
                forces.step(outcome.last_tick)
                now = time.monotonic()
                if before < 0 <= outcome.last_tick:
                    outcome.done("first_tick_answered")
                if before != outcome.last_tick:
                    progress = now
                elif now - progress > STALL:
                    raise StallError(_stall(monitor))
                if now >= due:
                    due = now + view.period
                    faults = monitor.faults()
                    first = faults[0] if faults else ""
                    view.show(monitor.progress(), rate(outcome.last_tick), first)
            outcome.position_error = monitor.progress().position_error

    def _come_to_rest(self, steering: Steering, monitor: Monitor) -> None:
        """Pause and wait for the answers to the last tick, so that it is complete in the bag."""
        with contextlib.suppress(SteeringError):
            steering.run(False, timeout=_REST, check=False)

        def is_at_rest() -> bool:
            self._processes.check()
            return monitor.is_at_rest

        with contextlib.suppress(NodeDiedError, TimeoutError):  # it will not answer any more
            wait_until(is_at_rest, _REST)
        if self.plan.record:
            threading.Event().wait(_LAST_HEARTBEATS)
        self.outcome.plant = monitor.plant_facts()

    def _check(self) -> None:
        self.signals.check()
        self._processes.check()


def _recorded(namespace: str) -> list[str]:
    """Return the patterns of the topics that belong to a run."""
    if namespace == "/":
        return [".*"]
    return [f"{namespace}/.*", "/diagnostics", "/clock", "/rosout", "/tf", "/tf_static"]


def _not_recorded(namespace: str) -> list[str]:
    """Return the commands of users; the run has accepted/... and rejected/... instead."""
    return [f"{namespace.rstrip('/')}/{topic}" for topic in USER_COMMANDS]


def _stall(monitor: Monitor) -> str:
    where = f"t = {1e-9 * monitor.tick:g} s" if monitor.tick >= 0 else "the start"
    faults = "; ".join(monitor.faults()) or "no node reports a fault"
    return f"no tick was answered for {STALL:g} s since {where}: {faults}; look at the logs"


def _process_age() -> float:
    """Return how long ago this process started [s], including the interpreter's own start."""
    with open("/proc/self/stat", encoding="ascii") as file:
        fields = file.read().rpartition(")")[2].split()
    with open("/proc/uptime", encoding="ascii") as file:
        now = float(file.read().split()[0])
    return now - int(fields[19]) / os.sysconf("SC_CLK_TCK")
