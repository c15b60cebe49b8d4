# SPDX-License-Identifier: Apache-2.0
"""Runs of the orchestrator that are measured."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.ros.middleware import isolated_domain
from tactile_hand_ros.ros.processes import CapturedProcess, executable_path

_TIMEOUT = 600.0  # s, on top of the simulated time


class BenchError(TactileHandError):
    """A run that was to be measured did not come to its end."""


def run_graph(seconds: float, *options: str) -> dict[str, Any]:
    """Run the orchestrator to its end.

    Args:
        seconds: Simulated time [s].
        *options: Its further options.

    Returns:
        Its summary, and under `wall_s` how long all of it took.

    Raises:
        BenchError: If there is nothing to measure.
    """
    fixed = ["--quiet", "--no-report", "--duration", str(seconds)]
    command = [executable_path("orchestrator")]
    with isolated_domain(), tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        with CapturedProcess([*command, *fixed, "--out", folder, *options]) as orchestrator:
            code, said = orchestrator.wait(_TIMEOUT + seconds), orchestrator.stderr
        wall = time.perf_counter() - began
        file = Path(folder) / "latest" / "summary.json"
        if code not in (0, 1) or not ("--no-record" in options or file.is_file()):
            raise BenchError(f"a run to be measured ended with {code}: {said}")
        summary: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.is_file() else {}
    return {**summary, "wall_s": wall}
