# SPDX-License-Identifier: Apache-2.0
"""The options of `tactile-hand run` and of the orchestrator, declared once."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.errors import ConfigurationError


def _scenarios(incomplete: str) -> list[str]:
    """Complete the name of a scenario in a shell."""
    from tactile_hand_ros.config.paths import scenario_names

    return [name for name in scenario_names() if name.startswith(incomplete)]


@dataclass(frozen=True)
class RunOptions:
    """The options of a run."""

    scenario: Annotated[
        str | None,
        typer.Argument(
            help="Scenario by name or YAML file, 'paper' by default.",
            autocompletion=_scenarios,
            show_default=False,
        ),
    ] = None
    named: Annotated[
        str | None, typer.Option("--scenario", help="The same as an option.", show_default=False)
    ] = None
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Keep the hand alive until Ctrl-C.")
    ] = False
    duration: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Simulated time [s], instead of the scenario's."),
    ] = None
    pacing: Annotated[
        str | None, typer.Option(help="lockstep or realtime, instead of the scenario's.")
    ] = None
    changes: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Another value, as plant.rate=250."),
    ] = field(default_factory=list)
    out: Annotated[Path, typer.Option(help="Where the runs are kept.")] = Path("runs")
    record: Annotated[bool, typer.Option(help="Record a bag.")] = True
    report: Annotated[bool, typer.Option(help="Write report.html of what was recorded.")] = True
    composed: Annotated[
        bool | None,
        typer.Option(
            "--composed/--processes",
            help="Run all nodes in one process, or each in its own; by default one process in "
            "real time and several in lockstep.",
            show_default=False,
        ),
    ] = None
    namespace: Annotated[str, typer.Option(help="Namespace of all nodes, as /left.")] = ""
    startup_timeout: Annotated[
        float,
        typer.Option(min=0.1, metavar="SECONDS", help="Longest wait for all nodes [s]."),
    ] = 30.0
    priority: Annotated[
        int, typer.Option(help="Priority of the nodes under SCHED_FIFO, 1 to 99; 0 for none.")
    ] = 0
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False

    @property
    def wanted(self) -> str:
        """The scenario to run, by name or file; ConfigurationError if given twice, or empty."""
        given = [name for name in (self.scenario, self.named) if name is not None]
        if len(given) > 1:
            raise ConfigurationError(
                f"the scenario is given twice, as '{given[0]}' and as --scenario '{given[1]}'; "
                "give one"
            )
        if given == [""]:
            raise ConfigurationError("the scenario is '', expected its name or a YAML file")
        return given[0] if given else "paper"
