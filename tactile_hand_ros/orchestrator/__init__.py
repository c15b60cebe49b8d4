# SPDX-License-Identifier: Apache-2.0
"""The orchestrator: starts the nodes of a scenario, watches, commands, stops and sums up."""

from __future__ import annotations

from collections.abc import Sequence

from tactile_hand_ros.jit.compiled import run_interpreted
from tactile_hand_ros.orchestrator.signals import Signals


def main(args: Sequence[str] | None = None) -> int:
    """Run the orchestrator and return its exit code.

    Args:
        args: Command line with program name; None takes ``sys.argv``.
    """
    signals = Signals()
    signals.install()
    run_interpreted()  # the few steps of the check do not justify loading Numba
    # Loading takes a second; a Ctrl-C in that time must not tear an import apart.
    from tactile_hand_ros.orchestrator.command import run

    return run(args, signals)
