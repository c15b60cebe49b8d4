# SPDX-License-Identifier: Apache-2.0
"""What the hand does when a part of it fails, and whether an ideal hold would keep the object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from studies.stalls import GuardedLoop, Outcome, Watch
from tactile_hand_ros.control.command_guard import GuardConfig
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

RATES = {"calls": 500.0, "lockstep": 500.0, "composed": 250.0, "processes": 250.0}
"""Ticks per second of simulated time."""

FAULT_TIME = 0.5
"""How long a fault lasts, by the wall clock [s]."""

_ENDLESS = 3600.0


@dataclass(frozen=True)
class Situation:
    """A scenario and the time at which something fails.

    Attributes:
        scenario: Name of the scenario.
        changes: What is different in it.
        time: Simulated time of the fault, s; up to 0.2 s later, by chance.
    """

    scenario: str
    changes: dict[str, Any]
    time: float


def _vertical(kind: str, start: float, force: float, **more: float) -> dict[str, Any]:
    return {"kind": kind, "start": start, "force": [0.0, 0.0, force], **more}


SITUATIONS = {
    "at rest": Situation("paper", {"targets": []}, 0.4),
    "moving": Situation("paper", {}, 0.5),
    "lifting": Situation(
        "lift",
        {
            "plant.disturbances": [
                _vertical("step", 0.0, 1.962),
                _vertical("ramp", 0.4, -1.962, duration=0.5),
            ]
        },
        0.5,
    ),
    "pulled": Situation(
        "pull", {"plant.disturbances": [_vertical("ramp", 0.3, -5.0, duration=0.3)]}, 0.4
    ),
    "heavy": Situation(
        "heavy",
        {
            "plant.disturbances": [
                _vertical("step", 0.0, 9.81),
                _vertical("ramp", 0.3, -9.81, duration=0.5),
            ]
        },
        0.8,
    ),
}


def scenario(situation: str, way: str) -> Scenario:
    """Return the scenario of a situation for a way to run."""
    chosen, rate = SITUATIONS[situation], RATES[way]
    base = load_scenario(chosen.scenario)
    changes: dict[str, Any] = {
        **chosen.changes,
        "duration": _ENDLESS,
        "plant.rate": rate,
        "plant.autostart": False,
        "plant.pacing": "lockstep" if way == "lockstep" else "realtime",
        "plant.command_timeout": 0.2,
        "plant.resend_after": 0.05,
    }
    if base.tactile_sensor.rate > rate:
        changes |= {"tactile_sensor.rate": rate, "tactile_sensor.bandwidth": 0.4 * rate}
    return load_scenario(chosen.scenario, changes)


@cache
def ideal(situation: str, way: str) -> Outcome:
    """Return what becomes of the object when the joints are held from the fault on, at once.

    No hand that stands still can do better: where this drops the object, no hand survives there.
    """
    guarded = GuardedLoop(scenario(situation, way), GuardConfig(age_limit=0))
    guarded.run(SITUATIONS[situation].time)
    watch = Watch(guarded)
    watch.run(FAULT_TIME, answers=False)
    if not watch.is_dropped:
        watch.run(0.3, answers=True, moves=True)
    return watch.outcome()
