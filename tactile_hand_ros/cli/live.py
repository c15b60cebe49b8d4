# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand live`: run a hand and steer it from a page."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.command_line import Signals, open_in_browser
from tactile_hand_ros.extras import optional
from tactile_hand_ros.orchestrator.options import RunOptions, with_options

_SCENARIO = "gravity"


@dataclass(frozen=True)
class LiveOptions(RunOptions):
    """The options of a run, and those of its page."""

    scenario: Annotated[
        str | None,
        typer.Argument(
            help="Scenario by name or YAML file, 'gravity' by default.", show_default=False
        ),
    ] = None
    port: Annotated[
        int, typer.Option(help="Port of the page; 0 for any free one.", min=0, max=65535)
    ] = 0
    browser: Annotated[bool, typer.Option(help="Open the page in a browser.")] = True
    bag: Annotated[
        Path | None, typer.Option(help="Show this finished run instead; starts nothing.")
    ] = None


@with_options
def live(options: LiveOptions) -> None:
    """Watch, steer and disturb a run in the browser.

    Prints the link of the page and opens it. The nodes share one process, in lockstep at the speed
    of real time; --processes and --pacing realtime change that. The run lasts until Ctrl-C, so
    --duration and --interactive have no effect. It is judged only by whether the object fell. Exit
    codes are those of `run`.
    """
    if options.bag is not None:
        _show(options.bag, options.browser)
        return
    optional("aiohttp", "The cockpit")  # before a folder of the run is made
    from tactile_hand_ros.orchestrator.cockpit import cockpit
    from tactile_hand_ros.orchestrator.command import start
    from tactile_hand_ros.scenario.scenario import load_scenario

    own = dataclasses.replace(
        options,
        scenario=options.scenario or (None if options.named else _SCENARIO),
        interactive=True,
        composed=options.composed is not False,
    )
    # In lockstep a busy computer slows time down, but never the hand's answers.
    defaults = ["plant.speed=1"]
    if not load_scenario(own.wanted).plant.palm_motion:
        # At rest until the page turns it. With a motion there is an IMU that measures it.
        defaults.append("plant.palm_motion=[{time: 0, rotation: [0, 0, 0]}]")
    own = dataclasses.replace(own, changes=[*defaults, *options.changes])
    companion = functools.partial(cockpit, port=options.port, browser=options.browser)
    raise typer.Exit(start(own, Signals().install(), [], "tactile-hand live", companion))


def _show(bag: Path, browser: bool) -> None:
    """Write the report of a finished run, the same page without a hand, and open it."""
    from tactile_hand_ros.report.page import write_report
    from tactile_hand_ros.run.run import Run

    file = write_report(Run(bag))
    print(file)
    if browser:
        open_in_browser(file.resolve().as_uri())


COMMANDS = (live,)
