# SPDX-License-Identifier: Apache-2.0
"""What the command line of the orchestrator asks for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Request:
    """The options of the command line, each under its own name."""

    scenario: str
    interactive: bool
    duration: float | None
    pacing: str | None
    changes: tuple[str, ...]
    out: Path
    record: bool
    report: bool
    open_report: bool
    composed: bool | None
    separate_recorder: bool
    namespace: str
    startup_timeout: float
    priority: int
    cpus: str
    quiet: bool
