# SPDX-License-Identifier: Apache-2.0
"""Runs the injections of the campaign, session by session, and keeps each result immediately."""

from __future__ import annotations

import itertools
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from studies.faults import situations
from studies.faults.in_process import run_in_process
from studies.faults.injection import injected
from studies.faults.outcome import (
    Outcome,
    failed,
    judge,
    recovery,
    why_not_begun,
)
from studies.faults.running_hand import RunningHand
from studies.faults.space import Run
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.sweep.engine import in_parallel

RESULTS = "faults.jsonl"

_RECOVERY = 10.0  # s, longest wait for a hand that drives again
_AFTERWARDS = 0.3  # s that are watched after it does

_STARTS = 3  # of a run that does not begin, after which it is not judged
_SLACK = 20.0  # s of real time for a second of simulated time

_BROKEN = (TactileHandError, TimeoutError, OSError)


def run_campaign(
    runs: Sequence[Run],
    done: Sequence[Outcome] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Outcome]:
    """Yield the outcome of each run that is not done yet.

    One session of nodes serves all runs of the same way and situation that follow each other;
    it is started again when a run has broken it.

    Args:
        runs: The runs, in the order of their sessions.
        done: Outcomes of an earlier campaign.
        progress: Called with the name of each run that is done.
    """
    known = {outcome.key for outcome in done}
    waiting = [run for run in runs if run.key not in known]
    for _, group in itertools.groupby(waiting, key=lambda run: run.session):
        left = list(group)
        if left[0].cell.way == "in-process":
            for outcome in in_parallel(run_in_process, left):
                progress(str(outcome.cell))
                yield outcome
            continue
        while left:
            for outcome in _run_session(tuple(left)):
                progress(str(left.pop(0).cell))
                yield outcome


def _run_session(runs: Sequence[Run]) -> Iterator[Outcome]:
    """Yield outcomes until all runs are done or one could not be judged."""
    cell, run = runs[0].cell, runs[0]
    scenario = situations.scenario(cell.situation, cell.way)
    composed = cell.way == "composed"
    with tempfile.TemporaryDirectory() as folder:
        try:
            with RunningHand(scenario, Path(folder), composed=composed) as hand:
                for run in runs:
                    yield run_one(hand, run)
        except _BROKEN as error:
            yield failed(run, error)


def run_one(hand: RunningHand, run: Run) -> Outcome:
    """Inject one fault and return what became of the object.

    Before anything fails it is judged whether the hand has begun to hold; if not, nothing is
    injected, and the run starts again. So the choice cannot depend on what the fault does.

    Raises:
        TimeoutError: If the hand does not begin.
    """
    moment = situations.SITUATIONS[run.cell.situation].time + run.delay
    for starts in range(1, _STARTS + 1):
        hand.begin()
        hand.wait_for_time(moment, _SLACK)
        reason = why_not_begun(hand)
        if not reason:
            break
    else:
        raise TimeoutError(f"not begun in {_STARTS} starts: {reason}")
    begin = time.monotonic()
    with injected(hand, run):
        _pass_time(hand, situations.FAULT_TIME)
    end = time.monotonic()
    deadline = end + _RECOVERY

    def is_back() -> bool:
        late = time.monotonic() > deadline
        return late or recovery(hand, hand.since(begin), end) is not None

    hand.wait(is_back, "the recovery")
    _pass_time(hand, _AFTERWARDS)
    return judge(hand, run, moment, begin, end, starts)


def _pass_time(hand: RunningHand, seconds: float) -> None:
    until = time.monotonic() + seconds
    hand.wait(lambda: time.monotonic() >= until, "time that passes")


def load(folder: Path) -> list[Outcome]:
    """Return the outcomes that a campaign has kept in a folder."""
    file = folder / RESULTS
    if not file.exists():
        return []
    lines = file.read_text(encoding="utf-8").splitlines()
    return [Outcome(**json.loads(line)) for line in lines if line.endswith("}")]


def keep(folder: Path, outcomes: Iterator[Outcome]) -> Iterator[Outcome]:
    """Yield outcomes, each of which is in the file before the next one begins."""
    with (folder / RESULTS).open("a", encoding="utf-8") as file:
        for outcome in outcomes:
            file.write(json.dumps(outcome.data()) + "\n")
            file.flush()
            yield outcome
