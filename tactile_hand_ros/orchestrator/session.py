# SPDX-License-Identifier: Apache-2.0
"""One run: start the nodes, wait until the graph is complete, command, watch, stop."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from rclpy.node import Node

from tactile_hand_ros import names
from tactile_hand_ros.command_line import Interrupted, Signals, os_sentence
from tactile_hand_ros.config.model import Config
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.names import (
    COMPOSED,
    CONTROLLER,
    OPTIMIZER,
    PLANT,
    RECORDER,
    REGULATOR,
    SENSOR,
)
from tactile_hand_ros.nodes.recorder.config import RecorderConfig
from tactile_hand_ros.orchestrator.monitor import Monitor, View, missing_endpoints
from tactile_hand_ros.orchestrator.processes import NodeDiedError, Processes
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.steering import Steering, SteeringError
from tactile_hand_ros.ros.processes import wait_until
from tactile_hand_ros.ros.qos import HEARTBEAT
from tactile_hand_ros.ros.scheduling import PRIORITY
from tactile_hand_ros.scenario.scenario import NODES, Scenario

# The recorder first, because it loads fast; then in order of decreasing loading time.
START_ORDER = (RECORDER, PLANT, CONTROLLER, OPTIMIZER, REGULATOR, SENSOR)
STOP_ORDER = ((PLANT, COMPOSED), (SENSOR, REGULATOR, OPTIMIZER, CONTROLLER), (RECORDER,))

STALL = 15.0  # s without an answered tick after which the run fails

_LOOK = 0.02  # s between polls of the nodes' messages
_FIRST_LOOK = 0.002  # s between polls before the first message
_GRAPH_LOOK = 0.03  # s between polls of the graph
_REST = 1.0  # s, longest wait for the answers to the last tick
_SHARED = ["/diagnostics", "/clock", "/rosout", "/tf", "/tf_static"]  # not in a namespace


class StallCheck:
    """Detects that a run has come to a stop.

    A user may pause any run. In an endless one a user may also stop a node, to see the joints held.
    """

    def __init__(self, *, is_endless: bool) -> None:
        """Start before the first tick; `is_endless` for a run that a user ends."""
        self._is_endless = is_endless
        self._last: int | None = None
        self._since = 0.0

    def step(self, now: float, tick: int, mode: str) -> bool:
        """Return whether no tick was answered for `STALL`, given the newest [ns]; `now` in s."""
        is_users = mode == "paused" or (self._is_endless and tick >= 0)
        if tick != self._last or is_users:
            self._last, self._since = tick, now
        return now - self._since > STALL


@dataclass(frozen=True)
class Plan:
    """The plan of a run; see `RunOptions`. The recorder ignores `priority`: it may be late."""

    scenario: Scenario
    namespace: str = "/"
    record: bool = True
    interactive: bool = False
    composed: bool = False
    startup_timeout: float = 90.0
    priority: int = 0

    @property
    def end(self) -> int | None:
        """Timestamp of the last tick [ns], None for an endless run."""
        return None if self.interactive else (self.scenario.ticks - 1) * self.scenario.plant.tick

    def process(self, node: str) -> str:
        """Return the executable of a node."""
        return COMPOSED if self.composed else node

    @property
    def ros_arguments(self) -> list[str]:
        """The ROS arguments that all processes share."""
        # The log here already has a node's output; a second one in the home folder is not needed.
        common = ["--ros-args", "--disable-external-lib-logs"]
        return common if self.namespace == "/" else [*common, "-r", f"__ns:={self.namespace}"]


@dataclass
class RunOutcome:
    """How a run ended, as far as the orchestrator observed it."""

    failure: str = ""  # why it ended early
    interrupted: bool = False  # whether a signal ended it
    complaints: list[str] = field(default_factory=list)  # on processes that did not stop cleanly
    first_tick: float | None = None  # s, from the orchestrator's start to the first answered tick
    last_tick: int = -1  # ns, the last answered tick, -1 for none
    plant: dict[str, str] = field(default_factory=dict)  # the plant's last diagnostics


class Session:
    """One run of a plan in a run directory; `outcome` is its result."""

    def __init__(self, plan: Plan, directory: RunDirectory, signals: Signals) -> None:
        """Take the plan, the directory for all output, and the signals that stop the run."""
        self.plan, self.directory, self.signals = plan, directory, signals
        self.outcome = RunOutcome()
        self._processes = Processes()

    def run(self, joining: AbstractContextManager[Node], view: View) -> RunOutcome:
        """Run to the end, to a signal or to a failure; stop all processes.

        `joining` provides the orchestrator's own node, in the namespace of the run. It is entered
        after the processes have started, so that they do not wait for it.
        """
        outcome = self.outcome
        with self._processes, contextlib.ExitStack() as stack:
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
        """Start all processes without waiting, so that they load at the same time."""
        configs = self._configs(self.directory.write_scenario(self.plan.scenario))
        for name in dict.fromkeys(map(self.plan.process, configs)):
            self.signals.check()
            own = [node for node in configs if self.plan.process(node) == name]
            words = [names.RECORD] if name == COMPOSED and RECORDER in own else []
            if self.plan.priority and name != RECORDER:
                words += [PRIORITY, str(self.plan.priority)]
            words += self.plan.ros_arguments
            for node in own:
                file = self.directory.write_parameters(node, configs[node])
                words += ["--params-file", str(file.resolve())]
            log = self.directory.log(name)
            self._processes.start(name, log, *words, records=RECORDER in own)

    def _configs(self, scenario_text: str) -> dict[str, Config]:
        """Return the parameters of the nodes in start order."""
        scenario, prefix = self.plan.scenario, self.plan.namespace.rstrip("/")
        endless = {"duration": 0.0} if self.plan.interactive else {}
        configs: dict[str, Config] = {node: getattr(scenario, node) for node in NODES}
        configs[PLANT] = scenario.plant.changed({"autostart": False, **endless})
        if self.plan.record:
            configs[RECORDER] = RecorderConfig(
                output=str(self.directory.bag.resolve()),
                topics=[f"{prefix}/.*", *(_SHARED if prefix else [])],
                # User commands; the bag has accepted/... and rejected/... instead.
                exclude=[f"{prefix}/{topic}" for topic in names.USER_COMMANDS],
                scenario=scenario_text,
            )
        return {node: configs[node] for node in START_ORDER if node in configs}

    def _command_and_watch(self, node: Node, view: View) -> None:
        scenario = self.plan.scenario
        steering = Steering(node, scenario, self._check)
        monitor = Monitor(node, closely=any(each.stamp > 0 for each in scenario.user_forces))
        self._await_graph(node, monitor, steering)
        steering.send_targets()
        steering.send_forces(0)
        steering.run(True)
        try:
            self._watch(monitor, view, steering)
        finally:
            self._come_to_rest(steering, monitor)

    def _await_graph(self, node: Node, monitor: Monitor, steering: Steering) -> None:
        """Wait until all nodes exist and have matched each other; else raise TactileHandError."""
        plan, own = self.plan, node.get_fully_qualified_name()
        members = [*NODES, names.ORCHESTRATOR]
        if plan.record and not plan.composed:
            members.append(RECORDER)
        end = time.monotonic() + plan.startup_timeout
        while True:
            missing = missing_endpoints(node, members, {**monitor.facts(), own: steering.facts})
            # One missing endpoint suffices: searching for all costs 5 % of a core while nodes load.
            first = next(missing, None)
            if first is None and steering.is_ready:
                return
            self._processes.check()
            if time.monotonic() > end:
                first = first or (PLANT, "the plant's service does not answer yet")
                raise TactileHandError(self._absence(dict(reversed([first, *missing]))))
            self.signals.wait(_GRAPH_LOOK)

    def _absence(self, missing: dict[str, str]) -> str:
        """Return the missing endpoints of each node and the last lines of its log."""
        lines = [
            f"the graph is not complete after {self.plan.startup_timeout:g} s: "
            f"{'; '.join(missing[name] for name in sorted(missing))}; "
            f"see {self.directory.path / 'logs'}"
        ]
        for name in dict.fromkeys(map(self.plan.process, missing)):
            lines += [f"{name} | {line}" for line in self._processes.tail(name)]
        return "\n".join(lines)

    def _watch(self, monitor: Monitor, view: View, steering: Steering) -> None:
        """Follow the run to its last tick, and send the user forces that are due."""
        outcome, end = self.outcome, self.plan.end
        due, stall = time.monotonic(), StallCheck(is_endless=end is None)
        while end is None or outcome.last_tick < end:
            self.signals.wait(_FIRST_LOOK if outcome.last_tick < 0 else _LOOK)
            self._processes.check()
            outcome.last_tick = monitor.answered()
            steering.send_forces(outcome.last_tick)
            now = time.monotonic()
            if outcome.first_tick is None and outcome.last_tick >= 0:
                outcome.first_tick = round(_process_age(), 3)
            if stall.step(now, outcome.last_tick, monitor.of(PLANT).get("mode", "")):
                raise TactileHandError(_stall(monitor))
            if now >= due:
                due = now + view.period
                view.show(monitor)

    def _come_to_rest(self, steering: Steering, monitor: Monitor) -> None:
        """Pause and wait for the answers to the last tick, so that the bag has all of it."""
        with contextlib.suppress(SteeringError):
            steering.run(False, timeout=_REST, check=False)

        def is_at_rest() -> bool:
            self._processes.check()
            return monitor.is_at_rest

        with contextlib.suppress(NodeDiedError, TimeoutError):  # no more answers will come
            wait_until(is_at_rest, _REST)
        if self.plan.record:
            threading.Event().wait(3.0 * HEARTBEAT)  # the recorder requests lost messages
        self.outcome.plant = monitor.of(PLANT)

    def _check(self) -> None:
        self.signals.check()
        self._processes.check()


def _stall(monitor: Monitor) -> str:
    where = f"t = {1e-9 * monitor.tick:g} s" if monitor.tick >= 0 else "the start"
    faults = "; ".join(monitor.faults()) or "no node reports a fault"
    return f"no tick was answered for {STALL:g} s since {where}: {faults}; see the logs"


def _process_age() -> float:
    """Return the age of this process [s], including the start of the interpreter."""
    with open("/proc/self/stat", encoding="ascii") as file:
        start = int(file.read().rpartition(")")[2].split()[19]) / os.sysconf("SC_CLK_TCK")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - start
