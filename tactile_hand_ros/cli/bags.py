# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand recover`: repair a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import BagArgument


def recover(
    bag: BagArgument,
    out: Annotated[
        Path | None, typer.Option(help="Folder to create; by default beside the bag.")
    ] = None,
) -> None:
    """Recover a bag that was cut off, from any recorder."""
    from tactile_hand_ros.bag import recover as r

    found = r.find_bag(bag)
    if out is None and r.is_whole(found):
        print(f"{found} is whole, there is nothing to recover")
        return
    print(r.recover(found, out).sentence)


COMMANDS = (recover,)
