# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand scenarios` and `show`: what can be run."""

from __future__ import annotations

from typing import Annotated

import typer

from tactile_hand_ros.cli.output import print_table


def scenarios() -> None:
    """List the scenarios of the package."""
    from tactile_hand_ros.config.paths import scenario_names
    from tactile_hand_ros.report import tables
    from tactile_hand_ros.scenario.scenario import load_scenario

    rows = []
    for name in scenario_names():
        scenario = load_scenario(name)
        rows.append([name, f"{scenario.duration:g} s", scenario.description])
    print_table(tables.rich_table("scenarios", ("name", "duration", "description"), rows))


def show(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a YAML file.")],
) -> None:
    """Print a scenario as YAML with every value resolved."""
    from tactile_hand_ros.scenario.scenario import load_scenario, resolved

    print(resolved(load_scenario(scenario)), end="")


COMMANDS = (scenarios, show)
