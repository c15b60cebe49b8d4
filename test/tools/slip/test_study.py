# SPDX-License-Identifier: Apache-2.0
"""The slip study: what is measured, on runs made by hand and on real ones, and its statistics."""

import math
from dataclasses import replace

import numpy as np
import pytest

from studies.slip import study
from studies.slip.minimum import minimum_at
from studies.slip.study import SlipCase
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.control.slip.detector import ContactState
from tactile_hand_ros.sweep.engine import workers
from tactile_hand_ros.sweep.table import keep, read_table

CASE = SlipCase(
    index=0,
    event="friction",
    friction=0.4,
    mass=0.5,
    noise=0.01,
    latency=0.001,
    rate=1000.0,
    load=3.5,
    pull=(0.0, 0.0, -1.0),
)


@pytest.fixture(scope="module")
def run() -> Record:
    """Return a run in which the object turns slippery."""
    return ClosedLoop(study.scenario_of(CASE)).run()


def made_up(run: Record) -> Record:
    """Return a copy of a run in which nothing ever slides and k_f stays."""
    still = {name: np.zeros_like(getattr(run, name)) for name in ("true_sliding", "true_slid")}
    still |= {"grip": np.ones_like(run.grip), "grasp_force": np.full_like(run.grasp_force, 5.0)}
    return replace(run, **still)


def measured(record: Record) -> dict[str, float]:
    """Measure a record as a run of the case."""
    return study.measure(record, study.scenario_of(CASE))


def test_cases_fill_their_ranges_and_repeat():
    """Every tenth of a range holds a tenth of the cases; a seed gives the same cases again."""
    cases = study.sample_cases(60, 4)
    assert cases == study.sample_cases(60, 4)
    assert cases != study.sample_cases(60, 5)
    for event in study.EVENTS:
        assert sum(case.event == event for case in cases) == 20
    counts, _ = np.histogram([math.log(case.mass) for case in cases], 10, np.log([0.05, 0.5]))
    assert (counts == 6).all()
    assert all(np.linalg.norm(case.pull) == pytest.approx(1.0) for case in cases)


def test_where_nothing_slides_nothing_is_measured_and_no_answer_is_infinitely_late(run):
    outcome = measured(made_up(run))
    assert np.isnan([outcome[name] for name in ("onset", "detection", "reaction")]).all()
    assert outcome["slip"] == 0.0 and outcome["false_alarms"] == 0
    assert outcome["caught"] and not outcome["lost"]
    record = made_up(run)
    record.true_sliding[150:180, 1] = 0.01
    assert measured(record)["detection"] == measured(record)["reaction"] == math.inf


def test_delays_are_counted_from_the_onset_of_the_contact_that_slides(run):
    """Contact 1 slides from 0.15 s on; its alarm comes 7 ms later, k_f rises after 9 ms."""
    record = made_up(run)
    record.true_sliding[150:180, 1] = 0.01
    record.true_slid[150:, 1] = 3e-4
    record.grip[152:160, 0] = ContactState.SLIP  # of another contact
    record.grip[157:170, 1] = ContactState.SLIP
    record.grasp_force[159:] = 6.0
    outcome = measured(record)
    assert outcome["onset"] == pytest.approx(0.150)
    assert outcome["detection"] == pytest.approx(0.007)
    assert outcome["reaction"] == pytest.approx(0.009)
    assert outcome["slip"] == pytest.approx(3e-4)


def test_a_contact_that_is_gone_or_has_slid_far_is_lost(run):
    gone, far = made_up(run), made_up(run)
    far.true_slid[-1, 0] = 2.0 * study.LOST_SLIDE
    positions = gone.true_positions.copy()
    positions[-1, 2] = np.nan
    assert measured(replace(gone, true_positions=positions))["lost"]
    assert measured(far)["lost"]


def test_an_alarm_is_false_only_where_nothing_slides(run):
    """Three alarms: one without reason, one while it slides and one just after."""
    record = made_up(run)
    record.true_sliding[150:180, 1] = 0.01
    for start in (60, 160, 190):
        record.grip[start : start + 5, 1] = ContactState.SLIP
    assert study.false_alarms(record) == 1


def test_a_slip_is_found_answered_and_stopped(run):
    """Friction falls to 0.11, more than the reserve was for: the object stays in the hand."""
    outcome = measured(run)
    assert outcome["survivable"] and not outcome["lost"] and outcome["false_alarms"] == 0
    assert outcome["excess"] > 1.0 and outcome["early_slip"] < 1e-5
    assert study.EVENT_TIME <= outcome["onset"] < study.EVENT_TIME + 0.005
    assert 0.0 < outcome["detection"] < 0.010
    assert 0.0 < outcome["reaction"] < 0.020


def test_the_minimum_grasp_force_of_a_run_follows_load_and_friction(run):
    """With friction down to 1 / 3.5, the minimum sum of normal forces is 3.5 times what it was."""
    scenario = study.scenario_of(CASE)
    before, after = (minimum_at(run, scenario, t, 100) for t in (0.05, 0.2))
    assert before >= 9.81 * CASE.mass / CASE.friction * (1 - 1e-9)
    assert after > 3.0 * before


LATE = [case for case in study.sample_cases(60, 3) if case.latency > 0.008 and case.rate == 250.0]


@pytest.mark.parametrize("event", study.EVENTS)
def test_a_late_and_slow_skin_is_believed_when_the_object_begins_to_slip(event):
    """Slip prevention is blind to touch that the controller doubts: true touch never is."""
    loop = ClosedLoop(study.scenario_of(next(case for case in LATE if case.event == event)))
    record = loop.run(1)
    for _ in range(1, loop.scenario.ticks):
        loop.tick(record, 0)
        assert not loop.controller.touch_rejected.any()


def test_a_small_study_gives_its_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "HELD", {"known": 0.3, "unknown": 0.3})
    with workers(1):
        keep(study.study_of(2, 0), tmp_path)
    table = read_table(tmp_path)
    assert len(table["outcome"]) == 5 and "failed" not in table["outcome"]
    assert [row[1] for row in study.rows(table)][-4:] == ["1", "2", "1", "1"]
    assert study.fraction_rows(table)[0][:2] == ["slipped", "2"]
