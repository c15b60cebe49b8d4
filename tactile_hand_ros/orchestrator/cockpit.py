# SPDX-License-Identifier: Apache-2.0
"""Offer the cockpit's page next to a run; the run does not depend on it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from rich.console import Console

from tactile_hand_ros.cockpit.config import LINK, CockpitConfig
from tactile_hand_ros.command_line import open_in_browser
from tactile_hand_ros.names import COCKPIT
from tactile_hand_ros.orchestrator.processes import NodeDiedError, Processes
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan

_PAUSE = 0.05  # s between two looks at the output of the cockpit


@contextlib.contextmanager
def cockpit(
    plan: Plan, directory: RunDirectory, console: Console, *, port: int, browser: bool
) -> Iterator[None]:
    """Run the cockpit and print its link; `browser` opens it too."""
    config = CockpitConfig(
        name=plan.scenario.name,
        hand=plan.scenario.hand,
        object=plan.scenario.plant.object,
        port=port,
        bag=str(directory.bag.resolve()) if plan.record else "",
    )
    file = directory.write_parameters(COCKPIT, config).resolve()
    words = [*plan.ros_arguments, "--params-file", str(file)]
    over = threading.Event()

    def announce() -> None:
        """Print the link once the cockpit has printed it, or why it never will."""
        while not over.wait(_PAUSE):
            try:
                processes.check()
            except NodeDiedError as error:
                console.print(f"{error}; the run continues without its page", soft_wrap=True)
                return
            lines = [line for line in processes.tail(COCKPIT) if line.startswith(LINK)]
            if lines:
                console.print(lines[0], soft_wrap=True)
                if browser:
                    open_in_browser(lines[0].removeprefix(LINK))
                return

    with Processes() as processes:
        processes.start(COCKPIT, directory.log(COCKPIT), *words)
        waiting = threading.Thread(target=announce, daemon=True)
        waiting.start()
        try:
            yield
        finally:
            over.set()
            waiting.join()  # only one thread may look whether a process has ended
