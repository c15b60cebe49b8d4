# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand recover` and `audit`: repair a bag, check what is in it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import EXIT_DIFFERS, BagArgument, NamespaceOption, print_table
from tactile_hand_ros.errors import TactileHandError


def recover(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to create; by default beside the bag.")
    ] = None,
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help="Repair the folder itself; keeps broken files as *.broken"),
    ] = False,
) -> None:
    """Repair a bag that was cut off, from any recorder."""
    from tactile_hand_ros.bag import recover as r

    if in_place and out is not None:
        raise TactileHandError("--in-place and --out were given, expected one of them.")
    found = r.find_bag(bag)
    if out is None and r.is_whole(found):
        print(f"{found} is whole, there is nothing to recover")
        return
    print(r.recover(found, out, in_place=in_place).sentence)


def audit(bag: BagArgument = Path("runs/latest"), namespace: NamespaceOption = None) -> None:
    """Check every recorded f* against (13) and every torque against the law, independently.

    Exit code 0 if all agree, 1 if not.
    """
    from tactile_hand_ros.report.tables import rich_table
    from tactile_hand_ros.run.run import Run
    from tactile_hand_ros.verify.audit import audit as audit_run
    from tactile_hand_ros.verify.checks import COLUMNS, rows
    from tactile_hand_ros.verify.recompute import reason

    run = Run(bag, namespace=namespace)
    checks = audit_run(run)
    print_table(rich_table("audit", COLUMNS, rows(checks)))
    wrong = [check for check in checks if not check.ok]
    for check in wrong:
        print(
            f"{check.name}: wrong at {check.wrong} of {check.ticks} ticks, first at tick "
            f"{check.first} ns",
            file=sys.stderr,
        )
    if wrong:
        print("Not all agrees with the configuration" + reason(run), file=sys.stderr)
        raise typer.Exit(EXIT_DIFFERS)


COMMANDS = (recover, audit)
