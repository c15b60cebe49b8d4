# SPDX-License-Identifier: Apache-2.0
"""The experiments behind the paper's claims, and each claim next to its measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.compiled import Array
from tactile_hand_ros.control.contact import hand_jacobian
from tactile_hand_ros.control.laws import LAWS, LawInput
from tactile_hand_ros.run import derived
from tactile_hand_ros.run.metrics import peak
from tactile_hand_ros.run.result import RunData
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario
from tactile_hand_ros.simulation.plant import Plant

LAYOUTS = ("three_faces", "pinch")

EXPERIMENTS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "optimal": ("paper", {}),
    "nominal": ("paper_nominal_weights", {}),
    "firm": ("paper", {"slip_regulator.grasp_force": 20.0}),
    "contact": ("contact_law", {}),
    "kawamura": ("kawamura", {}),
    "hold_optimal": ("paper", {"targets": []}),
    "hold_contact": ("contact_law", {"targets": []}),
    "hold_kawamura": ("kawamura", {"targets": []}),
}
"""Scenario and changes by dotted key: the paper's experiment under (14), with W = I, with
twice the grasp force, under (10) and (8); and each law holding the object in place."""


class ExperimentRun(RunData):
    """A finished experiment."""

    scenario: Scenario


def run_experiment(key: str, layout: str, duration: float | None = None) -> ExperimentRun:
    """Run one of `EXPERIMENTS` in-process; `duration` [s] replaces the scenario's."""
    scenario = scenario_of(key, layout, duration)
    return ExperimentRun(ClosedLoop(scenario).run(), scenario)


def scenario_of(key: str, layout: str, duration: float | None = None) -> Scenario:
    """Return the scenario of an experiment; ConfigurationError if layout or duration is invalid."""
    name, others = EXPERIMENTS[key]
    changes = {"layout": layout, **others, **({} if duration is None else {"duration": duration})}
    return load_scenario(name, changes)


Outcomes = Mapping[str, ExperimentRun]
"""The experiments of one layout by key."""


HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"

Finding = tuple[str, bool, bool]
"""What was measured, and whether the claim holds, or holds in part."""

_claims: list[tuple[str, str, Callable[[Outcomes], Finding]]] = []


def _claim(source: str, statement: str) -> Callable[[Callable[[Outcomes], Finding]], None]:
    """Mark the function that measures a claim of the paper."""
    return lambda measure: _claims.append((source, statement, measure))


def judge(outcomes: Outcomes) -> list[list[str]]:
    """Judge all claims, including Theorem 1 with (9), by the experiments of one layout.

    Return rows of source, statement, measured result and verdict.
    """
    found = []
    for source, statement, measure in _claims:
        measured, holds, partly = measure(outcomes)
        verdict = HOLDS if holds else PARTLY if partly else FAILS
        found.append([source, statement, measured, verdict])
    return found


@_claim("Fig. 3b, (15)", "The contact centroid converges to p_d.")
def _position(outcomes: Outcomes) -> Finding:
    error = outcomes["optimal"].metrics.final_position_error_m
    measured = f"{_millimetres(error)} from p_d at the end"
    return measured, error < 1e-4, error < 1e-2


@_claim("Fig. 3c, (15)", "The orientation error r_d converges to zero.")
def _orientation(outcomes: Outcomes) -> Finding:
    run = outcomes["optimal"]
    error = run.metrics.final_rotation_error_rad
    most = peak(np.linalg.norm(derived.rotation_error(run.record), axis=1))
    measured = f"|r_d| = {error:.1e} rad at the end, {most:.3f} rad at most on the way"
    return measured, error < 1e-3, error < 1e-1


@_claim("Fig. 3a", "The joint rates converge to zero.")
def _rates(outcomes: Outcomes) -> Finding:
    record = outcomes["optimal"].record
    rates = np.abs(record.rates)
    tick, joint = np.unravel_index(int(np.nanargmax(rates)), rates.shape)
    fastest, final = float(rates[tick, joint]), peak(rates[-1])
    measured = (
        f"{final:.1e} rad/s at the end; peak {fastest:.3f} rad/s of {record.joint_names[joint]} at "
        f"{record.times[tick]:.2f} s (the text gives no number to compare)"
    )
    return measured, final < 1e-3, final < 0.1 * fastest


@_claim("Fig. 3d, (15)", "Every normal force converges to k_f f*_n.")
def _normal_forces(outcomes: Outcomes) -> Finding:
    m = outcomes["optimal"].metrics
    worst, wanted = m.worst_normal_force_relative_error, m.optimal_normal_forces_N
    listed = ", ".join(f"{f:.4f}/{wanted[n]:.4f}" for n, f in m.final_normal_forces_N.items())
    measured = f"f_n / k_f f*_n: {listed} N; worst error {100 * worst:.4f} %"
    return measured, worst < 1e-3, worst < 5e-2


@_claim("(13c), (15)", "The normal forces sum to k_f.")
def _sum(outcomes: Outcomes) -> Finding:
    m = outcomes["optimal"].metrics
    total, k_f = m.normal_force_sum_N, m.final_grasp_force_N
    error = m.normal_force_sum_relative_error
    measured = f"{total:.5f} N for k_f = {k_f:g} N, {100 * error:.4f} % off"
    return measured, error < 1e-4, error < 1e-2


@_claim("Sec. IV-A", "While the object moves, normal forces deviate from k_f f*_n.")
def _in_motion(outcomes: Outcomes) -> Finding:
    run = outcomes["optimal"]
    apart = derived.contact_forces(run.record)[:, :, 1] - derived.expected_normal_forces(run.record)
    largest, final = peak(np.abs(apart[1:])), peak(np.abs(apart[-1:]))
    measured = f"by up to {largest:.3f} N in motion, {final:.1e} N at the end"
    return measured, largest > 10.0 * final, False


@_claim("Sec. IV", "With k_f = 10 and without the relative attitude term, (14) loses no contact.")
def _grasp_kept(outcomes: Outcomes) -> Finding:
    m = outcomes["optimal"].metrics
    measured = f"{m.contacts_lost_ticks} of {m.ticks} ticks without one of the contacts"
    return measured, m.contacts_lost_ticks == 0, False


@_claim(
    "Fig. 4, Sec. III", "Penalizing tangential forces reduces the friction that each contact needs."
)
def _friction(outcomes: Outcomes) -> Finding:
    penalised = outcomes["optimal"].metrics.final_required_friction
    nominal = outcomes["nominal"].metrics.final_required_friction
    less = [penalised[name] < nominal[name] for name in penalised]
    worst = max(penalised.values()), max(nominal.values())
    listed = ", ".join(
        f"{name.replace('_', ' ')} {nominal[name]:.3f} -> {penalised[name]:.3f}"
        for name in penalised
    )
    measured = (
        f"beta, nominal -> penalized: {listed}; the grasp as a whole needs "
        f"{worst[1]:.3f} -> {worst[0]:.3f}"
    )
    return measured, all(less), any(less)


@_claim("(13b)", "f* has no effect on the motion: W and k_f change forces only.")
def _internal_force(outcomes: Outcomes) -> Finding:
    names = {"nominal": "W = I", "firm": "twice k_f", "contact": "(10) for (14)"}
    apart = {key: _apart(outcomes["optimal"], outcomes[key]) for key in names}
    listed = ", ".join(f"{1e6 * apart[key]:.2f} um with {name}" for key, name in names.items())
    measured = f"the centroid's path differs by at most {listed}"
    return measured, max(apart.values()) < 1e-5, max(apart.values()) < 1e-3


@_claim(
    "Sec. III", "Squeezing through fingertips, (8), induces rolling; through contacts it does not."
)
def _rolling(outcomes: Outcomes) -> Finding:
    keys = {"hold_kawamura": "(8)", "hold_contact": "(10)", "hold_optimal": "(14)"}
    rolled = {key: peak(_until_loss(outcomes[key])) for key in keys}
    listed = ", ".join(f"{name} {_millimetres(rolled[key])}" for key, name in keys.items())
    end = _loss(outcomes["hold_kawamura"].metrics.first_contact_loss_s)
    induced = rolled["hold_kawamura"] > 1e-2
    still = max(rolled["hold_contact"], rolled["hold_optimal"]) < 1e-4
    measured = f"held where it is, contacts roll over the object by {listed}; under (8) {end}"
    return measured, induced and still, induced or still


@_claim(
    "Theorem 1, (9)", "Law (8) with Table I's gains reaches p_d (k_st = 0, as Table I prints none)."
)
def _kawamura(outcomes: Outcomes) -> Finding:
    m = outcomes["kawamura"].metrics
    end = _loss(m.first_contact_loss_s)
    lost = m.contacts_lost_ticks > 0
    error = m.final_position_error_m
    there = "" if math.isnan(error) else f", {_millimetres(error)} from p_d at the end"
    measured = f"{end}{there}; joint rates up to {m.peak_joint_rate_rad_per_s:.1f} rad/s"
    return measured, not lost and error < 1e-3, not lost and error < 1e-2


@_claim(
    "below (10)", "K_p is formed from the gains of (8): the same k_p pulls alike in (8) and (14)."
)
def _stiffness(outcomes: Outcomes) -> Finding:
    eight, fourteen = outcomes["kawamura"].scenario, outcomes["optimal"].scenario
    gain = fourteen.manipulation_controller.law.k_p
    fingers = len(outcomes["optimal"].record.finger_names)
    tips, contacts, other = (
        np.diag(translational_stiffness(*of))
        for of in ((eight, "tips"), (eight, "contacts"), (fourteen, "contacts"))
    )
    listed = ", ".join(f"{value:.2f}" for value in contacts)
    measured = (
        f"(8) pulls with {tips.mean():.2f} N/m at the tips ({fingers} times k_p) and {listed} N/m "
        f"(x, y, z) at the contacts, (14) with {other.mean():.2f} N/m"
    )
    return measured, bool(np.allclose(contacts, gain, rtol=0.01)), False


@_claim("Sec. II, (7)", "Moving the virtual frame to its target moves the object there.")
def _true_orientation(outcomes: Outcomes) -> Finding:
    turned = outcomes["optimal"].metrics.max_object_rotation_in_grasp_rad
    moved = outcomes["optimal"].metrics.max_object_displacement_in_grasp_m
    measured = (
        f"the cube itself turns up to {math.degrees(turned):.1f} deg and shifts up to "
        f"{_millimetres(moved)} against the virtual frame, because the tips roll on it"
    )
    return measured, turned < 0.01 and moved < 1e-3, turned < 0.5


def translational_stiffness(scenario: Scenario, at: str = "tips") -> Array:
    """Return the force on the object per meter of position error, shape (3, 3), N/m.

    Their joint torques equal the drive of the law at the start of the run. They act at the
    ``tips``, whose centers appear in (8), or at the ``contacts`` with the object.
    """
    plant = Plant(scenario.plant)
    contacts, tips = plant.state.contacts, plant.hand.fingertips(plant.state.theta)
    config = scenario.manipulation_controller.law
    law = LAWS[config.name](config, plant.hand.radii)
    law.seen = LawInput(tips, contacts, np.zeros((plant.hand.fingers, 3)), grasp_force=0.0)
    points = tips.positions if at == "tips" else contacts.positions
    frames = np.tile(np.eye(3), (len(points), 1, 1))
    jacobian = hand_jacobian(tips, points, frames).reshape(3 * len(points), -1)
    per_metre = config.k_p * np.eye(3, 6)  # the wrench of an error of 1 m along each axis
    torques = np.transpose([law.drive(wrench) for wrench in per_metre])
    forces = np.linalg.lstsq(jacobian.T, torques, rcond=None)[0]
    return np.asarray(forces.reshape(-1, 3, 3).sum(axis=0))


def _until_loss(run: ExperimentRun) -> Array:
    """Return how far contacts rolled over the object while all of them touched."""
    kept = run.record.times < np.nan_to_num(run.metrics.first_contact_loss_s, nan=np.inf)
    return np.asarray(derived.rolling(run.record)[kept])


def _apart(one: ExperimentRun, other: ExperimentRun) -> float:
    """Return the largest distance between the centroids of two runs."""
    between = one.record.auxiliary_position - other.record.auxiliary_position
    return float(np.linalg.norm(between, axis=1).max())


def _millimetres(metres: float) -> str:
    return "an unknown distance" if math.isnan(metres) else f"{1e3 * metres:.3g} mm"


def _loss(time: float) -> str:
    return "no contact is lost" if math.isnan(time) else f"a contact is lost at {time:.2f} s"
