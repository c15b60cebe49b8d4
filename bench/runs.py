# SPDX-License-Identifier: Apache-2.0
"""Runs of the orchestrator that are measured: what they achieved and what they took."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.domains import isolated_domain
from tactile_hand_ros.ros.histogram import parse_histogram
from tactile_hand_ros.ros.processes import CapturedProcess
from tactile_hand_ros.run.recording import Deadlines
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import NODES

Array = NDArray[np.float64]

PROCESSES = (*NODES, "recorder", "composed")
_TIMEOUT = 600.0  # s, on top of the simulated time
_HOLDING = 2  # fingers
_LOOK = 0.5  # s between two looks at the processes


class BenchError(TactileHandError):
    """A run that was to be measured did not come to its end."""


@dataclass(frozen=True)
class Usage:
    """What the processes of a run had taken at some time.

    Attributes:
        at: When [s].
        cpu: Processor time by process [s].
        memory: Resident memory by process [MiB].
    """

    at: float
    cpu: dict[str, float]
    memory: dict[str, float]


@dataclass(frozen=True)
class GraphRun:
    """A run with all its processes.

    Attributes:
        summary: The orchestrator's summary.
        plant: The last facts in the plant's diagnostics.
        usage: What the processes took, over time.
        load_time: Time to read all of the bag's topics into arrays [s].
        peak_grasp_force: Largest k_f [N].
        dropped: Whether fewer than two fingers touched when last something was felt.
    """

    summary: dict[str, Any]
    plant: dict[str, str]
    usage: Sequence[Usage]
    load_time: float = math.nan
    peak_grasp_force: float = math.nan
    dropped: bool = False

    @property
    def deadlines(self) -> Deadlines:
        """How a run in real time kept to it, as the orchestrator saw it."""
        return Deadlines.from_dict(self.summary["real_time"])

    @property
    def memory(self) -> dict[str, float]:
        """The largest resident memory by process [MiB]."""
        names = {name for each in self.usage for name in each.memory}
        return {n: max(each.memory.get(n, 0.0) for each in self.usage) for n in sorted(names)}

    @property
    def ages(self) -> Array:
        """From each tick to the arrival of its command at the plant, shape (n,), s."""
        return self._durations("age_histogram_us")

    @property
    def jitter(self) -> Array:
        """How far from its time each tick came in real time, shape (n,), s."""
        return self._durations("jitter_histogram_us")

    def _durations(self, key: str) -> Array:
        middles, counts = parse_histogram(self.plant.get(key, ""))
        return np.repeat(middles, counts) if len(counts) else np.array([np.nan])

    @property
    def cores(self) -> float:
        """How many cores all processes kept busy in the second half of the run."""
        half = self.usage[max(0, len(self.usage) - 1) // 2 :]
        passed = half[-1].at - half[0].at if half else 0.0
        if passed <= 0.0:
            return float("nan")
        return (sum(half[-1].cpu.values()) - sum(half[0].cpu.values())) / passed


def run_graph(seconds: float, *options: str, load: bool = False) -> GraphRun:
    """Run the orchestrator to its end.

    Args:
        seconds: Simulated time [s].
        *options: Its further options.
        load: Whether to measure how long its bag takes to load.

    Raises:
        BenchError: If there is nothing to measure.
    """
    fixed = ["--quiet", "--no-report", "--duration", str(seconds)]
    command = [sys.executable, "-m", "tactile_hand_ros.ros.executables", "orchestrator"]
    with isolated_domain(), tempfile.TemporaryDirectory() as folder:
        with CapturedProcess([*command, *fixed, "--out", folder, *options]) as orchestrator:
            usage = _watch(orchestrator, _TIMEOUT + seconds)
            code, said = orchestrator.wait(_TIMEOUT), orchestrator.stderr
        path = Path(folder) / "latest"
        file = path / "summary.json"
        if code not in (0, 1) or not file.is_file():
            raise BenchError(f"a run to be measured ended with {code}: {said}")
        plant = [each for each in Run(path).diagnostics if each.name == "/plant"]
        summary = json.loads(file.read_text(encoding="utf-8"))
        load_time = _load_time(path) if load else math.nan
        record = Run(path).record
        return GraphRun(
            summary,
            plant[-1].values if plant else {},
            usage,
            load_time,
            peak_grasp_force=float(np.nanmax(record.grasp_force, initial=0.0)),
            dropped=is_dropped(record),
        )


def is_dropped(record: Record) -> bool:
    """Return whether fewer than two fingers touched at the last tick of which touch is known."""
    touching = np.isfinite(record.contact_positions[:, :, 0]).sum(axis=1)
    known = np.isfinite(record.forces).any(axis=(1, 2)) | (touching > 0)
    return bool(known.any()) and bool(touching[known][-1] < _HOLDING)


def _load_time(path: Path) -> float:
    began = time.perf_counter()
    len(Run(path).record)  # it is read when it is first asked for
    return time.perf_counter() - began


def _watch(orchestrator: CapturedProcess, timeout: float) -> list[Usage]:
    """Look at the processes of a run until it ends."""
    usage: list[Usage] = []
    pause, end = threading.Event(), time.monotonic() + timeout
    family = psutil.Process(orchestrator.pid)
    while orchestrator.returncode is None and time.monotonic() < end:
        seen = usage_of(family)
        # While processes start and while they end, they tell little.
        if not usage or len(seen.cpu) >= len(usage[-1].cpu):
            usage.append(seen)
        pause.wait(_LOOK)
    return usage


def usage_of(orchestrator: psutil.Process) -> Usage:
    """Return what the processes that an orchestrator has started take now."""
    cpu, memory = {}, {}
    try:
        children = orchestrator.children(recursive=True)
    except psutil.NoSuchProcess:
        children = []
    for child in children:
        try:
            # Of the recorder inside `composed`, what has a process is a module that writes its bag.
            line = child.cmdline()[:3]
            words = {part for word in line for part in (Path(word).name, *word.split("."))}
            name = next((name for name in PROCESSES if name in words), None)
            if name is not None:
                cpu[name] = sum(child.cpu_times()[:2])
                memory[name] = child.memory_info().rss / 2**20
        except psutil.Error:  # it ended in the meantime
            continue
    return Usage(time.monotonic(), cpu, memory)


@contextmanager
def busy_cores(count: int) -> Iterator[None]:
    """Let processes that do nothing but count compete for the cores inside the block."""
    command = [sys.executable, "-c", "while True: pass"]
    with ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(CapturedProcess(command))
        yield
