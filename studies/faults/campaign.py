# SPDX-License-Identifier: Apache-2.0
"""The campaign as studies, one for each way to run, with one row per injection; its table."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.faults import situations, space
from studies.faults.in_process import run_in_process
from studies.faults.injection import injected
from studies.faults.outcome import Outcome, judge, recovery, why_not_begun
from studies.faults.running_hand import RunningHand
from studies.faults.space import Injection
from tactile_hand_ros.sweep.engine import FAILED, LOST, REACHED, Point, Study, workers
from tactile_hand_ros.sweep.results import fraction_of
from tactile_hand_ros.sweep.space import Choice
from tactile_hand_ros.sweep.table import Table, Watch, keep

_RECOVERY = 60.0  # s, maximum wait until the hand drives again; a busy machine starts nodes slowly
_POLL = 0.01  # s, between two looks for it
_AFTERWARDS = 0.3  # s of observation after that
_STARTS = 3  # attempts to start a run
_SLACK = 20.0  # s, maximum wall time to reach the fault


def run_campaign(
    runs: list[Injection],
    folder: Path,
    jobs: int = -1,
    watch: Watch = lambda done, total: None,
) -> None:
    """Make the missing runs of one way, and write the table of all runs.

    Args:
        runs: The runs.
        folder: Folder of the results, including those of an earlier, unfinished call.
        jobs: Number of processes for in-process runs; running hands are tested one at a time.
        watch: Called after each run.

    Raises:
        StudyError: If the folder contains another campaign or cannot be written.
    """
    is_live = runs[0].way != "in-process"
    with Hands() as hands, workers(1 if is_live else jobs):
        run = hands.run_one if is_live else run_one
        study = Study({"injection": Choice(tuple(runs))}, run)
        keep(study, folder, watch)


def run_one(point: Point) -> dict[str, Any]:
    """Make a run in-process."""
    return _row(run_in_process(point.values["injection"]))


def _row(outcome: Outcome) -> dict[str, Any]:
    return {**asdict(outcome), "outcome": LOST if outcome.dropped else REACHED}


class Hands(ExitStack):
    """The running hand of the last injection, kept for the next one in the same situation."""

    _hand: RunningHand
    _started: tuple[str, str, bool] | None = None  # way, situation, and whether it is recorded

    def run_one(self, point: Point) -> dict[str, Any]:
        """Make a run on nodes; restart them for the next run if this one fails."""
        run = point.values["injection"]
        recorded = run.component == space.RECORDER  # it takes a fifth of a core
        wanted = run.way, run.situation, recorded
        if self._started != wanted:
            self.close()
            folder = Path(self.enter_context(tempfile.TemporaryDirectory()))
            chosen = situations.scenario(run.situation, run.way)
            hand = RunningHand(chosen, folder, composed=run.way == "composed", recorded=recorded)
            self._hand = self.enter_context(hand)
        self._started = None
        result = _row(inject(self._hand, run))
        self._started = wanted
        return result


def inject(hand: RunningHand, run: Injection) -> Outcome:
    """Inject one fault and return the outcome.

    Before the injection, check that the hand holds the object; if not, start the run again. So the
    selection of runs cannot depend on the effect of the fault.

    Raises:
        TimeoutError: If the hand does not start to hold the object.
    """
    moment = situations.SITUATIONS[run.situation].time + run.delay
    for _ in range(_STARTS):
        hand.begin()
        hand.wait_for_time(moment, _SLACK)
        reason = why_not_begun(hand)
        if not reason:
            break
    else:
        raise TimeoutError(f"no grasp after {_STARTS} starts: {reason}")
    begin, pause = time.monotonic(), threading.Event()
    with injected(hand, run):
        pause.wait(situations.FAULT_TIME)
    end = time.monotonic()
    while recovery(hand, hand.since(begin), end) is None and time.monotonic() <= end + _RECOVERY:
        pause.wait(_POLL)
    pause.wait(_AFTERWARDS)
    return judge(hand, run, moment, begin, end)


COLUMNS = (
    *("", "runs", "drops", "95 % interval", "moved, worst [mm]", "safe, median [ms]"),
    *("peak / limit, worst", "recovered, median [s]"),
)


def rows(tables: Sequence[Table]) -> list[list[str]]:
    """Return a row for each way, situation, component and fault; columns as in `COLUMNS`."""
    found = []
    for table in tables:
        judged = table["outcome"] != FAILED  # failed runs started without a grasp
        way, is_none = str(table["way"][0]), table["fault"] == space.NONE
        faulty = judged & ~is_none
        found.append(row(f"{way}, no fault", table, judged & is_none))
        found.append(row(f"{way}, all faults", table, faulty))
        killed = np.isin(table["fault"], space.DEADLY) & np.isin(table["component"], space.HAND)
        if way != "in-process":
            found.append(row(f"{way}, nodes killed or stopped", table, faulty & killed))
        for name in ("situation", "component", "fault"):
            for value in dict.fromkeys(table[name][faulty]):
                found.append(row(f"{way}, {value}", table, faulty & (table[name] == value)))
    return found


def row(name: str, table: Table, chosen: NDArray[np.bool_]) -> list[str]:
    """Return the results of some runs as text."""
    some = {key: column[chosen] for key, column in table.items()}
    runs, drops = int(chosen.sum()), int((some["outcome"] == LOST).sum())
    if not runs:
        return [name, "0", *["-"] * 6]
    _, low, high = fraction_of(drops, runs)
    return [
        *(name, str(runs), str(drops), f"{100.0 * low:.1f} to {100.0 * high:.1f} %"),
        _text(1e3 * some["moved"][some["outcome"] != LOST], np.max, "{:.1f}"),
        _text(1e3 * some["safe"], np.median, "{:.0f}"),
        _text(some["peak"] / some["limit"], np.max, "{:.2f}"),
        _text(some["recovered"], np.median, "{:.2f}"),
    ]


def _text(values: Any, of: Callable[[Any], Any], form: str) -> str:
    known = values[~np.isnan(values)]
    return form.format(float(of(known))) if len(known) else "-"
