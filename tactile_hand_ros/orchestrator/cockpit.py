# SPDX-License-Identifier: Apache-2.0
"""Offer the cockpit's page next to a run; the run does not depend on it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from rich.console import Console

from tactile_hand_ros.cockpit.config import LINK, CockpitConfig
from tactile_hand_ros.command_line import open_in_browser
from tactile_hand_ros.extras import optional
from tactile_hand_ros.names import COCKPIT
from tactile_hand_ros.orchestrator.processes import NodeProcess, started_by
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan
from tactile_hand_ros.ros.processes import end_together, wait_until

_PATIENCE = 60.0  # s, of a cockpit that loads next to five nodes


@contextlib.contextmanager
def cockpit(
    plan: Plan, directory: RunDirectory, console: Console, *, port: int, browser: bool
) -> Iterator[None]:
    """Run the cockpit and print its link; `browser` opens it too.

    Raises:
        MissingLibraryError: If aiohttp is not installed.
    """
    optional("aiohttp", "the cockpit")
    config = CockpitConfig(
        name=plan.scenario.name,
        hand=plan.scenario.hand,
        object=plan.scenario.plant.object,
        port=port,
        bag=str(directory.bag.resolve()) if plan.record else "",
    )
    file = directory.write_parameters(COCKPIT, config)
    words = ["--ros-args", "--disable-external-lib-logs", "--params-file", str(file.resolve())]
    if plan.namespace != "/":
        words += ["-r", f"__ns:={plan.namespace}"]
    command = started_by(COCKPIT, ["setpriv", "--pdeathsig", "KILL", "--"])
    process = NodeProcess(COCKPIT, [*command, *words], directory.log(COCKPIT))

    def link() -> str:
        """Return the link that the cockpit has printed, empty before."""
        lines = (line for line in process.tail() if line.startswith(LINK))
        return next(lines, "").removeprefix(LINK)

    def announce() -> None:
        with contextlib.suppress(TimeoutError):
            wait_until(lambda: link() or process.returncode is not None, _PATIENCE)
        if found := link():
            console.print(f"cockpit: {found}", soft_wrap=True)
            if browser:
                open_in_browser(found)
        else:
            reason = (process.tail() or [f"see {process.log}"])[-1]
            console.print(f"the cockpit did not start: {reason}", soft_wrap=True)

    threading.Thread(target=announce, daemon=True).start()
    try:
        yield
    finally:
        end_together([process])
