# SPDX-License-Identifier: Apache-2.0
"""One look for all figures: sizes of a paper column, colors that color-blind eyes tell apart."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_hand_ros.extras import optional

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE = 7.16
"""Width of a paper's page, in."""
DPI = 220

INK, FAINT = "#222222", "#8a8a8a"
# Okabe and Ito (2008): first the fingers, then the axes, so that no color means two things.
_FINGERS = ("#0072B2", "#D55E00", "#009E73", "#7A5195", "#8C6D1F", "#444444")
_AXES = ("#CC79A7", "#E69F00", "#56B4E9")
JOINT_LINES = ("-", "--", ":", "-.")

_PARAMETERS: dict[str, Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "figure.dpi": 100.0,
    "svg.fonttype": "none",
    # The same numbers give the same bytes.
    "svg.hashsalt": "tactile_hand_ros",
}


def finger_color(index: int) -> str:
    """Return the color of a finger by its index; of a run or outcome where no finger is shown."""
    return _FINGERS[index % len(_FINGERS)]


def axis_color(index: int) -> str:
    """Return the color of x, y or z."""
    return _AXES[index]


def pretty(name: str) -> str:
    """Return a name as people write it: ``finger_1`` becomes ``finger 1``."""
    return name.replace("_", " ")


@contextmanager
def look() -> Iterator[None]:
    """Draw in this style inside the block.

    Raises:
        MissingLibraryError: If matplotlib is not installed.
    """
    matplotlib = optional("matplotlib", "Drawing")
    with matplotlib.rc_context(_PARAMETERS):
        yield


def new_figure(width: float, height: float, layout: str = "constrained") -> Figure:
    """Return an empty figure of a size in inches, without the global state of pyplot."""
    made: Figure = optional("matplotlib.figure", "Drawing").Figure(
        figsize=(width, height), layout=layout
    )
    return made


def label_panel(axes: Axes, letter: str, title: str) -> None:
    """Head a panel with its letter and what it shows."""
    axes.set_title(f"({letter}) {title}", loc="left", pad=4.0)


# No dates and versions inside, so that equal runs give equal files.
_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
}


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and as SVG, and return the files.

    Args:
        figure: The figure.
        folder: Where to; created if it does not exist.
        name: Name without suffix.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{suffix}" for suffix in ("png", "svg")]
    with look():
        for file in files:
            figure.savefig(file, dpi=DPI, metadata=_METADATA.get(file.suffix))
    return files
