# SPDX-License-Identifier: Apache-2.0
"""`tactile-hand reproduce`: the paper's figures and claims."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tactile_hand_ros.cli.output import (
    FormatOption,
    JobsOption,
    Progress,
    folder_for_results,
    print_files,
    print_table,
)


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures and tables.")] = Path(
        "reproduction"
    ),
    layout: Annotated[
        list[str] | None, typer.Option(help="Layout of the fingers; may be repeated.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time in s instead of the paper's 10 s.")
    ] = None,
    jobs: JobsOption = -1,
    formats: FormatOption = None,
) -> None:
    """Draw the paper's figures and print its claims beside what was measured."""
    from tactile_hand_ros.report.tables import rich_table
    from tactile_hand_ros.reproduce import tables
    from tactile_hand_ros.reproduce.experiments import EXPERIMENTS, LAYOUTS
    from tactile_hand_ros.reproduce.reproduce import draw, write
    from tactile_hand_ros.reproduce.reproduce import reproduce as run
    from tactile_hand_ros.sweep.engine import workers

    layouts = list(dict.fromkeys(layout or LAYOUTS))
    kinds = folder_for_results(out, formats)
    with Progress("running the paper", len(layouts) * len(EXPERIMENTS)) as advance, workers(jobs):
        results = run(layouts, duration, advance)
    with Progress("drawing", len(results)) as advance:
        files = []
        for result in results:
            files += draw(result, out, kinds)
            advance(result.layout)
    files += write(results, out, kinds[0])
    for result in results:
        print_table(tables.claim_table(f"layout {result.layout}", result.claims))
        title = f"what the laws do, layout {result.layout}"
        print_table(rich_table(title, tables.LAW_COLUMNS, tables.law_rows(result.laws)))
    print_files(files, out)
