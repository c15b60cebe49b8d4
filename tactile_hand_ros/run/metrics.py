# SPDX-License-Identifier: Apache-2.0
"""The results of a run as numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.events import alarm_count, slip_count
from tactile_hand_ros.scenario.scenario import GoalConfig, Scenario

DROPPED = "object dropped"
REACHED = "goal reached"
NOT_REACHED = "goal not reached"
STEERED = "finished"  # by the user who steered the run: no goal applies
START_S = 0.02  # initial time that friction peaks leave out, s: at tick 0 no force acts yet


def json_ready(value: Any) -> Any:
    """Replace NaN and infinity, which JSON lacks, by None in nested plain data."""
    if isinstance(value, Mapping):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True)
class Judged:
    """One number that the goal of a scenario limits; its value is NaN if unknown."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def passed(self) -> bool:
        """Whether the value is known and within its limit."""
        return self.value <= self.limit


@dataclass(frozen=True)
class Metrics:
    """Results of a run; NaN if the record does not contain them. Mappings are keyed by finger.

    Final values are those of the last tick; they are NaN if the grasp was lost by then.

    Attributes:
        final_position_error_m: |p_d - p|, p as the hand estimates it.
        final_rotation_error_rad: |r_d|, 2 sin of the angle.
        settling_time_s: From the last change of the desired pose until both errors stay inside the
            goal (1 mm and 0.01 rad without a scenario).
        final_normal_forces_N: f_n.
        optimal_normal_forces_N: k_f f*_n, where (15) puts f_n.
        worst_normal_force_relative_error: Largest |f_n / (k_f f*_n) - 1|.
        normal_force_sum_relative_error: |sum / k_f - 1|.
        final_required_friction: beta.
        max_required_friction: Largest beta after the first 0.02 s.
        contacts_lost_ticks: Ticks at which a finger did not touch.
        max_object_displacement_in_grasp_m: True object against the virtual frame of the contacts.
        max_slip_distance_m: Largest total slip distance of a contact; NaN without ground truth.
        slip_count: How often a contact started to slide; None without ground truth.
        dropped_at_s: When the object was dropped; NaN if it was held or released.
        goal_reached: Whether the object is held, the final errors are within the goal, and no
            contact is known to have slid too far; None without a scenario.
        link_inside: Name of the first link but for tips that came inside the object, empty if
            none did. The simulation lets them pass.

    Example:
        >>> from tactile_hand_ros import simulate
        >>> found = simulate("paper", {"duration": 0.1, "targets": []}).metrics
        >>> found.ticks, found.is_dropped, found.to_dict()["contacts_lost_ticks"]
        (51, False, 0)
    """

    ticks: int
    simulated_time_s: float
    final_position_error_m: float
    final_rotation_error_rad: float
    settling_time_s: float
    peak_joint_rate_rad_per_s: float
    final_grasp_force_N: float
    final_normal_forces_N: Mapping[str, float]
    optimal_normal_forces_N: Mapping[str, float]
    worst_normal_force_relative_error: float
    normal_force_sum_N: float
    normal_force_sum_relative_error: float
    peak_normal_force_N: float
    final_required_friction: Mapping[str, float]
    max_required_friction: Mapping[str, float]
    contacts_lost_ticks: int
    first_contact_loss_s: float
    max_object_displacement_in_grasp_m: float
    max_object_rotation_in_grasp_rad: float
    max_slip_distance_m: float
    slip_count: int | None
    slip_alarm_count: int
    dropped_at_s: float
    goal_reached: bool | None
    link_inside: str = ""
    link_inside_s: float = math.nan

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, in which NaN and infinity become None."""
        plain: dict[str, Any] = json_ready(asdict(self))
        return plain

    @property
    def link_note(self) -> str:
        """The link inside the object and its time in words."""
        return f"{self.link_inside} from {self.link_inside_s:.3g} s"

    @property
    def is_dropped(self) -> bool:
        """Whether the object was dropped."""
        return not math.isnan(self.dropped_at_s)

    def judged(self, goal: GoalConfig) -> list[Judged]:
        """Return the numbers that a goal limits; slip only with ground truth."""
        found = [
            Judged("final position error", self.final_position_error_m, goal.position_error, "m"),
            Judged(
                "final rotation error", self.final_rotation_error_rad, goal.rotation_error, "rad"
            ),
        ]
        if not math.isnan(self.max_slip_distance_m):
            found.append(Judged("longest slip", self.max_slip_distance_m, goal.slip_distance, "m"))
        return found

    def headline(self, *, steered: bool = False) -> str:
        """Return the outcome of the run in a few words; empty if no goal applies."""
        if self.is_dropped:
            return f"{DROPPED} at {self.dropped_at_s:.3f} s"
        if steered or self.goal_reached is None:
            return STEERED if steered else ""
        return REACHED if self.goal_reached else NOT_REACHED


def metrics(
    record: Record, scenario: Scenario | None = None, *, releases: Sequence[float] = ()
) -> Metrics:
    """Measure a run: how close it comes to (7), and in its normal forces to (15).

    The record has at least one tick; ground truth and single topics may be missing. The scenario
    gives the goal, and `releases` when a user opened the hand, s.
    """
    goal = GoalConfig() if scenario is None else scenario.goal
    whole, record = record, _answered(record)
    dropped = derived.dropped_at(record, releases)
    position, rotation = derived.pose_errors(record, dropped)
    inside = (position <= goal.position_error) & (rotation <= goal.rotation_error)
    missing = np.isnan(record.contact_positions[:, :, 0]).any(axis=1)
    lost = record.times[missing & ~derived.silent(record)]
    moved, turned = derived.motion_in_grasp(record)
    slid = peak(record.true_slid)
    found = Metrics(
        ticks=len(whole),
        simulated_time_s=float(whole.times[-1] - whole.times[0]),
        final_position_error_m=float(position[-1]),
        final_rotation_error_rad=float(rotation[-1]),
        settling_time_s=_settling(record, inside),
        peak_joint_rate_rad_per_s=peak(np.abs(record.rates)),
        **_force_metrics(record),
        contacts_lost_ticks=len(lost),
        first_contact_loss_s=float(lost[0]) if len(lost) else math.nan,
        max_object_displacement_in_grasp_m=peak(moved),
        max_object_rotation_in_grasp_rad=peak(turned),
        max_slip_distance_m=slid,
        slip_count=None if math.isnan(slid) else slip_count(record),
        slip_alarm_count=alarm_count(record),
        dropped_at_s=dropped,
        goal_reached=None,
    )
    if scenario is None:
        return found
    is_good = not found.is_dropped and all(each.passed for each in found.judged(goal))
    return replace(found, goal_reached=is_good)


def _answered(record: Record) -> Record:
    """Return it without its last ticks if they have no command: a recording may end in between."""
    known = np.flatnonzero(np.isfinite(record.command).any(axis=1))
    end = int(known[-1]) + 1 if len(known) else 0
    return record.part(slice(end)) if end and len(record) - end < derived.LONG else record


def _force_metrics(record: Record) -> dict[str, Any]:
    """Return the metrics of normal forces, against k_f f*_n and k_f, and of friction."""
    every = derived.contact_forces(record)[:, :, 1]
    normal, optimal = every[-1], derived.expected_normal_forces(record)[-1]
    grasp_force = float(record.grasp_force[-1])
    total = float(normal.sum()) if len(normal) else math.nan
    off = _relative(normal, optimal)
    beta = derived.required_friction(record)
    later = record.times >= record.times[0] + START_S
    peaks = np.array([peak(column) for column in beta[later].T])
    return {
        "final_grasp_force_N": grasp_force,
        "final_normal_forces_N": _by_finger(record, normal),
        "optimal_normal_forces_N": _by_finger(record, optimal),
        "worst_normal_force_relative_error": float(off.max()) if off.size else math.nan,
        "normal_force_sum_N": total,
        "normal_force_sum_relative_error": float(_relative(np.array(total), np.array(grasp_force))),
        "peak_normal_force_N": peak(every),
        "final_required_friction": _by_finger(record, beta[-1]),
        "max_required_friction": _by_finger(record, peaks),
    }


def _settling(record: Record, inside: NDArray[np.bool_]) -> float:
    """Return the time from the last change of the desired pose until the errors stay inside."""
    if not inside[-1]:
        return math.nan
    outside = np.flatnonzero(~inside)
    settled = int(outside[-1]) + 1 if len(outside) else 0
    desired = np.hstack([record.desired_position, record.desired_quaternion])
    same = (desired[1:] == desired[:-1]) | (np.isnan(desired[1:]) & np.isnan(desired[:-1]))
    changes = np.flatnonzero(~same.all(axis=1))
    commanded = int(changes[-1]) + 1 if len(changes) else 0
    return float(max(0.0, record.times[settled] - record.times[commanded]))


def peak(values: Array) -> float:
    """Return the largest known value, NaN if there is none."""
    return float(np.fmax.reduce(values, axis=None, initial=math.nan))


def _relative(value: Array, expected: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.abs(value - expected) / np.abs(expected))


def _by_finger(record: Record, values: Array) -> dict[str, float]:
    return {n: float(v) for n, v in zip(record.finger_names, values, strict=True)}
