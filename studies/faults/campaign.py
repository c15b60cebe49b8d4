# SPDX-License-Identifier: Apache-2.0
"""The campaign as studies, one for each way to run, with one row per injection."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from studies.faults import situations
from studies.faults.in_process import run_in_process
from studies.faults.injection import injected
from studies.faults.outcome import Outcome, judge, recovery, why_not_begun
from studies.faults.running_hand import RunningHand
from studies.faults.space import Injection
from tactile_hand_ros.sweep.engine import LOST, REACHED, Point, Study, workers
from tactile_hand_ros.sweep.space import Choice
from tactile_hand_ros.sweep.table import Watch, keep

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


class Hands:
    """The running hand of the last injection, kept for the next one in the same situation."""

    def __init__(self) -> None:
        """Start without a hand."""
        self._stack, self._key = ExitStack(), ("", "")

    def __enter__(self) -> Hands:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the nodes."""
        self._stack.close()

    def run_one(self, point: Point) -> dict[str, Any]:
        """Make a run on nodes; restart them for the next run if this one fails."""
        run = point.values["injection"]
        with self._hand(run) as hand:
            return _row(inject(hand, run))

    @contextmanager
    def _hand(self, run: Injection) -> Iterator[RunningHand]:
        if self._key != (run.way, run.situation):
            self._stack.close()
            folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
            chosen = situations.scenario(run.situation, run.way)
            hand = RunningHand(chosen, folder, composed=run.way == "composed")
            self._current = self._stack.enter_context(hand)
            self._key = run.way, run.situation
        try:
            yield self._current
        except BaseException:
            self._key = "", ""
            raise


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
