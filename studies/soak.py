# SPDX-License-Identifier: Apache-2.0
"""A long run in real time: does anything grow, come late or fall?"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from studies.faults.running_hand import RunningHand
from tactile_hand_ros import names
from tactile_hand_ros.ros.scheduling import Scheduling
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

_PERIOD = 0.5  # s between two samples
_WARM = 0.5  # fraction of the run after which growth counts: caches fill at first


@dataclass
class Soak:
    """What a long run did.

    Attributes:
        ticks: How many there were.
        late: Commands that were not there when the next tick was due.
        held: Ticks in which the joints were held.
        is_held: Whether all fingers touch at the end.
        times: When the samples were taken, s.
        memory: Resident memory of the hand's nodes at these times, bytes.
        recorder: The same of the recorder, which keeps the index of its bag.
        descriptors: Open files and sockets of all nodes.
        threads: Threads of all nodes.
    """

    ticks: int = 0
    late: int = 0
    held: int = 0
    is_held: bool = False
    times: list[float] = field(default_factory=list)
    memory: list[int] = field(default_factory=list)
    recorder: list[int] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)
    threads: list[int] = field(default_factory=list)

    def slope(self, memory: list[int]) -> float:
        """Return how fast a memory grows after the warm-up, bytes/s, as a straight line fits it."""
        first = int(_WARM * len(self.times))
        if len(self.times) - first < 2:
            return 0.0
        return float(np.polyfit(self.times[first:], memory[first:], 1)[0])

    def growth(self, samples: list[int]) -> int:
        """Return by how much something is more at the end than after the warm-up."""
        return samples[-1] - samples[int(_WARM * len(samples))]


def soak_scenario(rate: float, *, lockstep: bool = False) -> Scenario:
    """Return the paper's scenario without end, in real time or in lockstep."""
    changes = {
        "duration": 86400.0,
        "plant.rate": rate,
        "plant.autostart": False,
        "plant.pacing": "lockstep" if lockstep else "realtime",
    }
    return load_scenario("paper", changes)


def soak(
    scenario: Scenario,
    seconds: float,
    *,
    composed: bool,
    priority: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Soak:
    """Run the nodes for a time and look at them twice a second.

    Args:
        scenario: What they run.
        seconds: How long, by the wall clock.
        composed: Whether in one process.
        priority: Of the nodes under SCHED_FIFO; 0 for ordinary scheduling.
        progress: Called at each look.
    """
    seen, scheduling = Soak(), Scheduling(priority)
    with (
        tempfile.TemporaryDirectory() as folder,
        RunningHand(scenario, Path(folder), composed=composed, scheduling=scheduling) as hand,
    ):
        nodes = {name: psutil.Process(process.pid) for name, process in hand.processes.items()}
        hand.begin()
        start, pause = time.monotonic(), threading.Event()
        while (now := time.monotonic() - start) < seconds:
            _sample(seen, nodes, now)
            progress(f"{now:.0f} s")
            hand.forget_but(10_000)
            pause.wait(_PERIOD)
        seen.is_held = hand.is_touching(hand.events)
        facts = hand.facts(names.PLANT)
    seen.ticks = int(facts.get("tick_ns", 0)) // scenario.plant.tick
    seen.late, seen.held = int(facts.get("late_commands", 0)), int(facts.get("held_ticks", 0))
    return seen


def _sample(seen: Soak, nodes: dict[str, psutil.Process], now: float) -> None:
    resident = {name: node.memory_info().rss for name, node in nodes.items()}
    seen.times.append(now)
    seen.recorder.append(resident.pop(names.RECORDER))
    seen.memory.append(sum(resident.values()))
    seen.descriptors.append(sum(node.num_fds() for node in nodes.values()))
    seen.threads.append(sum(node.num_threads() for node in nodes.values()))


def summary(seen: Soak) -> dict[str, float]:
    """Return what a long run shows, by name and unit."""
    ticks = max(1, seen.ticks)
    return {
        "seconds": seen.times[-1] if seen.times else 0.0,
        "ticks": seen.ticks,
        "late_percent": 100.0 * seen.late / ticks,
        "held_percent": 100.0 * seen.held / ticks,
        "memory_KiB_per_min": 60.0 / 1024.0 * seen.slope(seen.memory),
        "recorder_KiB_per_min": 60.0 / 1024.0 * seen.slope(seen.recorder),
        "more_descriptors": seen.growth(seen.descriptors),
        "more_threads": seen.growth(seen.threads),
        "drops": float(not seen.is_held),
    }
