# SPDX-License-Identifier: Apache-2.0
"""The cases of the slip study: what is varied, and the scenario that follows from it.

Every run starts where the hand stands once it knows the object: with the friction as the estimate
and the squeeze that this takes. After a while the surface turns slippery, or the object is pulled.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from studies.slip.survival import least_against
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.extras import optional
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant

Array = NDArray[np.float64]
Event = Literal["friction", "step", "ramp"]

EVENTS: tuple[Event, ...] = ("friction", "step", "ramp")
LOADS = {"friction": (1.2, 3.5), "step": (1.5, 8.0), "ramp": (1.5, 8.0)}
RATES = (250.0, 500.0, 1000.0)
CENTROID = (0.0, 0.0434, 0.4098)  # of the contacts at the start: the object is held where it is
EVENT_TIME, DURATION, RAMP = 0.07, 0.19, 0.05  # s
_INERTIA = 0.0113  # of a uniform cube of this size, per mass, m^2


@dataclass(frozen=True)
class SlipCase:
    """What is varied from run to run.

    Attributes:
        index: Number of the run; it seeds the sensor.
        event: What happens.
        friction: mu before the event.
        mass: Mass of the object, kg.
        noise: Standard deviation of each force component, N.
        latency: Age of a tactile sample, s.
        rate: Samples per second, Hz.
        load: Least squeeze after the event against that before it.
        pull: Direction of the pull.
    """

    index: int
    event: Event
    friction: float
    mass: float
    noise: float
    latency: float
    rate: float
    load: float
    pull: tuple[float, float, float]


def sample_cases(runs: int, seed: int) -> list[SlipCase]:
    """Return cases that fill the ranges evenly, by Latin-hypercube sampling.

    Args:
        runs: Number of cases.
        seed: The same seed gives the same cases.
    """
    qmc = optional("scipy.stats.qmc", "The slip study")
    cases = []
    for i, u in enumerate(qmc.LatinHypercube(d=9, rng=np.random.default_rng(seed)).random(runs)):
        angle, tilt = 2.0 * math.pi * u[7], 0.5 * u[8]
        sideways, event = math.sin(tilt), EVENTS[int(3 * u[0])]
        cases.append(
            SlipCase(
                index=i,
                event=event,
                friction=_between(0.2, 1.0, u[1]),
                mass=_between(0.05, 0.5, u[2]),
                noise=_between(0.002, 0.03, u[3]),
                latency=round(0.01 * u[4], 4),
                rate=RATES[int(3 * u[5])],
                load=_between(*LOADS[event], u[6]),
                pull=(
                    sideways * math.cos(angle),
                    sideways * math.sin(angle),
                    -math.cos(tilt),
                ),
            )
        )
    return cases


def _between(low: float, high: float, share: float) -> float:
    """Return a value at a share of the logarithm of a range."""
    return float(low * (high / low) ** share)


def pull_of(case: SlipCase) -> SlipCase:
    """Return 10 N at once on 0.2 kg with mu = 0.5, felt at 1 kHz with a case's noise and delay."""
    load, down = 1.0 + 10.0 / (9.81 * 0.2), (0.0, 0.0, -1.0)
    return replace(case, event="step", friction=0.5, mass=0.2, rate=1000.0, load=load, pull=down)


@functools.cache
def _start() -> tuple[Contacts, Array]:
    """Return the contacts and the centre of mass at the start of a run."""
    plant = Plant(_base().plant)
    return plant.state.contacts, plant.state.position


@functools.cache
def _base() -> Scenario:
    return load_scenario("gravity")


def scenario_of(case: SlipCase, **changes: Any) -> Scenario:
    """Return the scenario of a case, by default with its event.

    Args:
        case: What is varied.
        changes: Values by dotted key with two underscores for a dot, over those of the case.
    """
    base = _base().slip_regulator
    contacts, position = _start()
    wrench = np.array([0.0, 0.0, -9.81 * case.mass, 0.0, 0.0, 0.0])
    least = least_against(contacts, position, wrench, case.friction)
    squeeze = min(max(1.3 * least, base.minimum), base.maximum)
    values = {
        "duration": DURATION,
        "seed": case.index + 1,
        "targets": [{"time": 0.0, "position": list(CENTROID)}],
        "plant.object.mass": case.mass,
        "plant.object.inertia": [_INERTIA * case.mass] * 3,
        "plant.object.friction": case.friction,
        "tactile_sensor.force_noise": case.noise,
        "tactile_sensor.latency": case.latency,
        "tactile_sensor.rate": case.rate,
        "slip_regulator.grasp_force": squeeze,
        "slip_regulator.friction.prior": case.friction,
        **_event(case),
        **{key.replace("__", "."): value for key, value in changes.items()},
    }
    return load_scenario("gravity", values)


def _event(case: SlipCase) -> dict[str, Any]:
    if case.event == "friction":
        change = {"start": EVENT_TIME, "friction": case.friction / case.load}
        return {"plant.friction_changes": [change]}
    force = [9.81 * case.mass * (case.load - 1.0) * x for x in case.pull]
    push = {"kind": case.event, "start": EVENT_TIME, "duration": RAMP, "force": force}
    return {"plant.disturbances": [push]}
