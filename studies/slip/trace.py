# SPDX-License-Identifier: Apache-2.0
"""Forces as detectors saw them, recorded once, so that detectors can be replayed over them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from studies.slip.cases import EVENT_TIME
from studies.slip.outcomes import SLIDING
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.contact import Contacts
from tactile_hand_ros.control.loads import split
from tactile_hand_ros.control.slip.detector import ContactState, SlipDetector, SlipDetectorConfig
from tactile_hand_ros.errors import CollinearContactsError
from tactile_hand_ros.scenario.scenario import Scenario

Array = NDArray[np.float64]

_AGO = 4  # ticks in which the regulator looks for changes of its own squeeze


@dataclass(frozen=True)
class Trace:
    """What the detectors of a run were given, and what was true.

    Attributes:
        step: Time between ticks, s.
        forces: Measured forces in contact frames, shape (n, k, 3), N; NaN where nothing touches.
        axes: Direction of the squeeze at each contact, shape (n, k, 3).
        own_change: How much the hand itself bent its squeeze, shape (n,), N.
        friction: What was believed of each contact's friction, shape (n, k).
        sliding: True sliding speeds, shape (n, k), m/s.
    """

    step: float
    forces: Array
    axes: Array
    own_change: Array
    friction: Array
    sliding: Array

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self.forces) * self.step


def record_trace(scenario: Scenario) -> Trace:
    """Run a scenario and keep what its detectors saw."""
    return trace_of(ClosedLoop(scenario).run(), scenario)


def trace_of(record: Record, scenario: Scenario) -> Trace:
    """Return what the detectors of a run were given."""
    follows = scenario.slip_regulator.mode != "user"
    axes = np.zeros_like(record.forces)
    axes[:, :, 1] = 1.0
    forces = record.forces.copy()
    for i in range(len(record)):
        contacts = Contacts.from_poses(record.contact_positions[i], record.contact_quaternions[i])
        if follows and contacts.touching.all():
            axes[i] = _axes(contacts, record.forces[i], axes[i])
        forces[i, ~contacts.touching] = np.nan
    bends = np.zeros(len(record))
    bends[2:] = np.abs(np.diff(record.grasp_force, 2))
    own = [float(bends[max(0, i - _AGO) : i].max(initial=0.0)) for i in range(len(record))]
    step = 1.0 / scenario.plant.rate
    # A tick is judged with what was believed after the one before.
    prior = np.full_like(record.friction[:1], scenario.slip_regulator.friction.prior)
    believed = np.concatenate([prior, record.friction[:-1]])
    return Trace(step, forces, axes, np.array(own), believed, record.true_sliding)


def _axes(contacts: Contacts, forces: Array, otherwise: Array) -> Array:
    try:
        return split(contacts, forces).internal
    except CollinearContactsError:
        return otherwise


def replay(
    trace: Trace, config: SlipDetectorConfig, noise: float = 0.0, seed: int = 0
) -> NDArray[np.int_]:
    """Return what detectors say of a trace, `ContactState` of each contact, shape (n, k).

    Args:
        trace: Recorded forces.
        config: Parameters of the detectors.
        noise: Standard deviation of the noise that is added to each component, N.
        seed: Of the noise.
    """
    white = np.random.default_rng(seed).standard_normal(trace.forces.shape)
    forces = trace.forces + noise * white
    detector = SlipDetector(config, forces.shape[1])
    states = np.zeros(forces.shape[:2], dtype=np.int64)
    for i, own_change in enumerate(trace.own_change.tolist()):
        dt = trace.step if i else 0.0
        states[i] = detector.step(forces[i], trace.axes[i], own_change, dt, trace.friction[i])
    return states


def alarms(states: NDArray[np.int_]) -> int:
    """Count alarms that begin, over all contacts."""
    slips = states == ContactState.SLIP
    return int((slips[1:] & ~slips[:-1]).sum() + slips[0].sum())


def delay(trace: Trace, states: NDArray[np.int_]) -> float:
    """Return the time from the first sliding to an alarm of that contact, in s.

    NaN where nothing slid, infinite where no alarm came.
    """
    if math.isnan(onset(trace)):
        return math.nan
    slides, first = trace.sliding > SLIDING, int(onset(trace))
    told = (states[first:, slides[first]] == ContactState.SLIP).any(axis=1)
    return float(told.argmax()) * trace.step if told.any() else math.inf


def onset(trace: Trace) -> float:
    """Return the first tick with sliding since the event, NaN if there is none."""
    first = round(EVENT_TIME / trace.step)
    slides = (trace.sliding[first:] > SLIDING).any(axis=1)
    return float(first + slides.argmax()) if slides.any() else math.nan
