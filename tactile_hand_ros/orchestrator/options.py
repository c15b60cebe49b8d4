# SPDX-License-Identifier: Apache-2.0
"""The options of `tactile-hand run` and of the orchestrator, declared once as a dataclass."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

import typer

from tactile_hand_ros.errors import ConfigurationError

Result = TypeVar("Result")


@dataclass(frozen=True)
class RunOptions:
    """The options of a run."""

    scenario: Annotated[
        str | None,
        typer.Argument(
            help="Scenario by name or YAML file, 'paper' by default.", show_default=False
        ),
    ] = None
    named: Annotated[
        str | None, typer.Option("--scenario", help="Scenario, as an option.", show_default=False)
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
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Override a value, such as plant.rate=250."
        ),
    ] = field(default_factory=list)
    out: Annotated[Path, typer.Option(help="Folder of all runs.")] = Path("runs")
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
    namespace: Annotated[str, typer.Option(help="Namespace of all nodes, such as /left.")] = ""
    startup_timeout: Annotated[
        float,
        typer.Option(min=0.1, metavar="SECONDS", help="Startup timeout [s]."),
    ] = 90.0
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


def with_options(command: Callable[..., Result]) -> Callable[..., Result]:
    """Show Typer the fields of a dataclass such as `RunOptions` as the options of a command.

    Each field is annotated like a parameter of a Typer command, and has a default. Other parameters
    of the command stay unchanged.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    kind = inspect.Parameter.KEYWORD_ONLY
    for parameter in signature.parameters.values():
        if not is_dataclass(parameter.annotation):
            parameters.append(parameter.replace(kind=kind))
            continue
        name = parameter.name
        options: Any = parameter.annotation
        hints, defaults = get_type_hints(options, include_extras=True), options()
        for each in fields(options):
            default = getattr(defaults, each.name)
            parameters.append(
                inspect.Parameter(each.name, kind, default=default, annotation=hints[each.name])
            )

    @functools.wraps(command)
    def run(**given: Any) -> Result:
        own = {each.name: given.pop(each.name) for each in fields(options)}
        return command(**given, **{name: options(**own)})

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    return run
