# SPDX-License-Identifier: Apache-2.0
"""The hand's task when a part of it fails, and the permitted positions of the object.

Even without a fault, a moving hand leaves the straight line to its goal, and a growing load
displaces the object. So the distance is measured to the nearest of two references: the object's
path without a fault, and its positions under an ideal hold that starts at about the fault.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from studies.faults.space import SPREAD
from studies.stalls import GuardedLoop
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.command_guard import GuardConfig
from tactile_hand_ros.errors import DivergedError
from tactile_hand_ros.extras import optional
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

# In real time, two slow cores keep up with five processes and their observer at 200 Hz.
RATES = {
    "paper": {"in-process": 500.0, "lockstep": 500.0, "composed": 250.0, "processes": 200.0},
    "human": {"in-process": 1000.0, "lockstep": 1000.0, "composed": 1000.0, "processes": 200.0},
}
"""Ticks per second of simulated time, by hand and way."""

FAULT_TIME = 1.0
"""Duration of a fault in wall time [s]."""

_ENDLESS = 3600.0


class Situation(NamedTuple):
    """A scenario, changed by dotted key, and the simulated time of the fault in it [s].

    A random delay of up to 0.2 s is added to the time.
    """

    scenario: str
    time: float
    changes: Mapping[str, Any]


def _pushes(*pushes: tuple[float, float, float]) -> dict[str, Any]:
    """Return vertical forces on the object: start [s], force [N], rise time [s], 0 for a step."""
    found = []
    for start, force, rise in pushes:
        push = {"kind": "ramp" if rise else "step", "start": start, "force": [0.0, 0.0, force]}
        found.append({**push, "duration": rise} if rise else push)
    return {"plant.disturbances": found}


SITUATIONS = {
    "at rest": Situation("paper", 0.4, {"targets": []}),
    "moving": Situation("paper", 0.5, {}),
    "lifting": Situation("lift", 0.5, _pushes((0.0, 1.962, 0.0), (0.4, -1.962, 0.5))),
    "pulled": Situation("pull", 0.4, _pushes((0.3, -5.0, 0.3))),
    "heavy": Situation("heavy", 0.8, _pushes((0.0, 9.81, 0.0), (0.3, -9.81, 0.5))),
    "human, at rest": Situation("human_hold", 0.4, {}),
    "human, turning": Situation("human_turn", 2.05, {}),
    "human, lifting": Situation("human_lift", 0.5, _pushes((0.0, 2.943, 0.0), (0.4, -2.943, 0.5))),
    "human, pulled": Situation("human_pull", 0.4, _pushes((0.3, -4.0, 0.3))),
}


def scenario(situation: str, way: str) -> Scenario:
    """Return the scenario of a situation for a way to run."""
    chosen = SITUATIONS[situation]
    base = load_scenario(chosen.scenario)
    rate = RATES[base.hand][way]
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


_STEP = 0.05  # s between two ideal holds
_DRIVEN = 3.0  # s after the earliest fault, enough for every situation to come to rest
_HELD = 1.5  # s, enough for all loads to be applied


class Expected(NamedTuple):
    """Positions of the object in one situation, m.

    Attributes:
        times: Simulated times, shape (n,), s.
        driven: Its positions at these times without a fault, shape (n, 3).
        holds: Its positions under an ideal hold, shape (n, 3), by the start time of the hold [s].
    """

    times: Array
    driven: Array
    holds: dict[float, Array]

    def distance(self, seen: Array, moment: float) -> float:
        """Return the largest distance of observed positions, (n, 3), from the permitted ones [m].

        `moment` is the simulated time of the fault [s]. On a busy computer a target arrives late,
        so the object can be where the path was before; from there on, the path is permitted.
        """
        if not len(seen) or not np.isfinite(seen).all():
            return math.inf
        path = self.driven[self.times <= moment]
        start = self.times[np.linalg.norm(path - seen[0], axis=1).argmin()]
        holds = [points for begin, points in self.holds.items() if begin > start - _STEP]
        known = np.concatenate([self.driven[self.times >= start - _STEP / 10.0], *holds])
        nearest = optional("scipy.spatial", "The distance of the object").KDTree(known)
        return float(nearest.query(seen)[0].max())


@cache
def expected(situation: str, way: str) -> Expected:
    """Return the permitted positions in a situation, computed in-process at the rate of a way."""
    first = SITUATIONS[situation].time
    driven = _positions(situation, way, first + _DRIVEN, 0.0)
    rate = scenario(situation, way).plant.rate
    begins = [first + i * _STEP for i in range(round(SPREAD / _STEP) + 1)]
    holds = {begin: _positions(situation, way, begin, _HELD) for begin in begins}
    return Expected((1 + np.arange(len(driven))) / rate, driven, holds)


def _positions(situation: str, way: str, driven: float, held: float) -> Array:
    """Return the object's position at each tick of the drive, or of the hold after it."""
    guarded = GuardedLoop(scenario(situation, way), GuardConfig(age_limit=0))
    seen: list[Array] = []
    try:
        for seconds, answers in ((driven, True), (held, False)):
            if not seconds:
                break
            seen.clear()
            for _ in range(round(seconds * guarded.rate)):
                guarded.tick(answers=answers)
                seen.append(guarded.loop.state.position.copy())
    except DivergedError:
        pass  # a hold that fails ends early
    return np.array(seen).reshape(-1, 3)
