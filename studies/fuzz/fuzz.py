# SPDX-License-Identifier: Apache-2.0
"""Reads hostile inputs for a time, counts what goes wrong, and keeps what did it."""

from __future__ import annotations

import itertools
import json
import random
import signal
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import psutil

from studies.fuzz.targets import Target
from tactile_hand_ros.errors import ConfigurationError, TactileHandError

LONGEST = 2.0
"""Processor time after which an input counts as a hang [s]."""

GROWTH = 50 * 2**20
"""Memory by which a process may grow [bytes]."""

_WARM = 300  # inputs after which memory is measured for the first time
_LOOK = 200  # inputs between two looks at the memory


class Hang(BaseException):
    """An input took too long; no `Exception`, so that no reader takes it for a refusal."""


@dataclass
class Report:
    """What hostile inputs did.

    Attributes:
        seed: Seed of all of them.
        inputs: How many were read, by target.
        refused: How many were refused in a sentence, by target.
        findings: Each a name, the target, the number of the input and what happened.
        growth: Largest growth of the memory of a process, bytes.
        grew_most: The node that has grown so; empty for the process that reads.
        slowest: Longest processor time for one input, s.
    """

    seed: int
    inputs: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    findings: list[dict[str, Any]] = field(default_factory=list)
    growth: int = 0
    grew_most: str = ""
    slowest: float = 0.0

    @property
    def grew(self) -> bool:
        """Whether a process has grown by more than it may."""
        return self.growth > GROWTH

    def data(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "seed": self.seed,
            "inputs": dict(self.inputs),
            "refused": dict(self.refused),
            "findings": self.findings,
            "growth_MB": round(self.growth / 2**20, 1),
            "grew_most": self.grew_most,
            "slowest_s": round(self.slowest, 3),
        }


def chance_of(seed: int, target: str, number: int) -> random.Random:
    """Return what an input is made with: the same for the same seed, on every machine."""
    return random.Random(f"{seed}/{target}/{number}")


def fuzz(
    targets: Mapping[str, Target],
    seconds: float,
    seed: int,
    folder: Path,
) -> Report:
    """Read inputs, of each target in turn, until the time is over.

    Args:
        targets: What reads them, by name.
        seconds: How long; the last input may take some longer.
        seed: Seed of all inputs.
        folder: Where an input is kept that was not survived.
    """
    report = Report(seed)
    process = psutil.Process()
    memory, end = 0, time.monotonic() + seconds
    turn = [name for name, target in targets.items() for _ in range(target.weight)]
    for count, name in enumerate(itertools.cycle(turn)):
        if time.monotonic() >= end:
            break
        number = report.inputs[name]
        data = targets[name].make(chance_of(seed, name, number))
        finding = _try(report, name, targets[name], data)
        if finding:
            keep(report, folder, name, number, data, finding)
        if count == _WARM:
            memory = process.memory_info().rss
        if count > _WARM and count % _LOOK == 0:
            grown = process.memory_info().rss - memory
            if grown > report.growth:
                report.growth, report.grew_most = grown, ""
    return report


def _try(report: Report, name: str, target: Target, data: bytes) -> str:
    """Read one input; return what went wrong, empty if nothing did."""
    report.inputs[name] += 1
    start, finding = time.process_time(), ""
    try:
        with _at_most(LONGEST):
            target.read(data)
    except TactileHandError:
        report.refused[name] += 1
    except Hang:
        finding = f"hang: more than {LONGEST:g} s"
    except Exception as error:
        finding = f"death: {type(error).__name__}: {error}"[:300]
    report.slowest = max(report.slowest, time.process_time() - start)
    return finding


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Interrupt a block that uses more processor time; waiting for a busy machine is no hang."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def keep(report: Report, folder: Path, name: str, number: int, data: bytes, finding: str) -> None:
    """Note a finding, and keep the input that it came from."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name.replace(' ', '-')}-{report.seed}-{number}.bin"
    file.write_bytes(data)
    found = {"target": name, "number": number, "what": finding, "file": str(file)}
    report.findings.append(found)
    file.with_suffix(".json").write_text(json.dumps(found) + "\n", encoding="utf-8")


def replay(targets: Mapping[str, Target], file: Path) -> str:
    """Read a kept input again and return what went wrong, empty if nothing did.

    Raises:
        ConfigurationError: If the file was not kept by `fuzz`.
    """
    note = file.with_suffix(".json")
    if not (file.is_file() and note.is_file()):
        raise ConfigurationError(f"'{file}' and '{note.name}' beside it are needed to replay")
    name = json.loads(note.read_text(encoding="utf-8"))["target"]
    if name not in targets:
        raise ConfigurationError(f"there is no target '{name}'; known are {', '.join(targets)}")
    return _try(Report(0), name, targets[name], file.read_bytes())
