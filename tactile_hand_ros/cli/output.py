# SPDX-License-Identifier: Apache-2.0
"""Common parts of the commands: options, tables, progress, output folders."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile_hand_ros.errors import TactileHandError, counted

if TYPE_CHECKING:
    from rich.console import Console


def _number_of_processes(jobs: int) -> int:
    if jobs < 1 and jobs != -1:
        raise typer.BadParameter(f"expected 1 or more processes, or -1 for all cores, got {jobs}")
    return jobs


JobsOption = Annotated[
    int,
    typer.Option(help="Number of processes; -1 for one per core.", callback=_number_of_processes),
]


SeedOption = Annotated[int, typer.Option(help="Seed of everything random.", min=0)]


def check_writable(folder: Path) -> None:
    """Create a folder for results before the work starts; raise TactileHandError if it fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TactileHandError(
            f"{folder} cannot be created ({error.strerror}); choose another folder."
        ) from None
    if not os.access(folder, os.W_OK):
        raise TactileHandError(f"{folder} is not writable; choose another folder.")


def console(stderr: bool = False) -> Console:
    """Return a console that is wide enough for tables in files and pipes."""
    from rich.console import Console

    made = Console(stderr=stderr, markup=False)
    if not made.is_terminal:
        made.width = 140  # the width of a file or pipe is unknown; 80 would cut tables
    return made


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table."""
    from tactile_hand_ros.report.tables import rich_table

    console().print(rich_table(title, columns, rows))


def print_files(files: Sequence[Path], folder: Path) -> None:
    """Print the names of the files written to a folder."""
    print(f"{counted(len(files), 'file')} in {folder}: {', '.join(file.name for file in files)}")


@contextlib.contextmanager
def bar(title: str, total: float | None = None) -> Iterator[Callable[..., None]]:
    """Show a bar on a terminal, nothing elsewhere; without `total`, it has no end.

    Yield `rich.progress.Progress.update`.
    """
    from rich.progress import Progress

    output = console(stderr=True)
    shown = Progress(console=output, transient=True, disable=not output.is_terminal)
    task = shown.add_task(title, total=total)
    with shown:
        yield functools.partial(shown.update, task)


@contextlib.contextmanager
def steps(title: str, total: int) -> Iterator[Callable[[str], None]]:
    """Show a bar for some steps; yield a function to call with the name of each finished step."""
    with bar(title, total) as update:
        yield lambda latest: update(advance=1, description=f"{title}: {latest}")


@contextlib.contextmanager
def progress(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of a study; yield a function to call with the finished and all runs."""
    with bar(title) as update:
        yield lambda done, total: update(
            completed=done, total=total, description=f"{title}: {done} of {total}"
        )
