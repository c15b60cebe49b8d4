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
        samples: Time [s], resident memory of the hand's nodes and of the recorder, which keeps the
            index of its bag [bytes], open files and sockets, and threads of all nodes.
    """

    ticks: int = 0
    late: int = 0
    held: int = 0
    is_held: bool = False
    samples: list[tuple[float, ...]] = field(default_factory=list)

    def summary(self) -> dict[str, float]:
        """Return what the run shows, by name and unit; memory grows as a straight line fits it."""
        ticks, samples = max(1, self.ticks), np.array(self.samples)
        warm = samples[int(_WARM * len(samples)) :]
        times, nodes, recorder, descriptors, threads = warm.T
        per_minute = 60.0 / 1024.0
        return {
            "seconds": float(times[-1]),
            "ticks": self.ticks,
            "late_percent": 100.0 * self.late / ticks,
            "held_percent": 100.0 * self.held / ticks,
            "memory_KiB_per_min": per_minute * float(np.polyfit(times, nodes, 1)[0]),
            "recorder_KiB_per_min": per_minute * float(np.polyfit(times, recorder, 1)[0]),
            "more_descriptors": float(descriptors[-1] - descriptors[0]),
            "more_threads": float(threads[-1] - threads[0]),
            "drops": float(not self.is_held),
        }


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
            resident = {name: node.memory_info().rss for name, node in nodes.items()}
            recorder = resident.pop(names.RECORDER)
            descriptors = sum(node.num_fds() for node in nodes.values())
            threads = sum(node.num_threads() for node in nodes.values())
            seen.samples.append((now, sum(resident.values()), recorder, descriptors, threads))
            progress(f"{now:.0f} s")
            hand.forget_but(10_000)
            pause.wait(_PERIOD)
        seen.is_held = hand.is_touching(hand.events)
        facts = hand.facts(names.PLANT)
    seen.ticks = int(facts.get("tick_ns", 0)) // scenario.plant.tick
    seen.late, seen.held = int(facts.get("late_commands", 0)), int(facts.get("held_ticks", 0))
    return seen
