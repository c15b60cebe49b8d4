# SPDX-License-Identifier: Apache-2.0
"""The style of all figures: sizes of a paper column, colors for color-blind readers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_hand_ros.extras import optional

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = 7.16
"""Width of a paper's page, inches."""
DPI = 220

INK, FAINT = "#222222", "#8a8a8a"
# Okabe and Ito (2008): fingers first, then axes, so that each color has one meaning.
_FINGERS = ("#0072B2", "#D55E00", "#009E73", "#7A5195", "#8C6D1F", "#444444")
AXES = ("#CC79A7", "#E69F00", "#56B4E9")
"""Colors of x, y and z."""
JOINT_LINES = ("-", "--", ":", "-.")

_PARAMETERS: dict[str, Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 4.0,
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
    # Equal numbers give equal bytes.
    "svg.hashsalt": "tactile_hand_ros",
}


def finger_color(index: int) -> str:
    """Return the color of a finger, or of a run or outcome in a figure without fingers."""
    return _FINGERS[index % len(_FINGERS)]


def pretty(name: str) -> str:
    """Return a readable name: ``finger_1`` becomes ``finger 1``."""
    return name.replace("_", " ")


@contextmanager
def look() -> Iterator[None]:
    """Apply this style inside the context; raise MissingLibraryError without matplotlib."""
    matplotlib = optional("matplotlib", "Drawing")
    with matplotlib.rc_context(_PARAMETERS):
        yield


def new_figure(width: float, height: float, layout: str = "constrained") -> Figure:
    """Return an empty figure of a size in inches, without the global state of pyplot."""
    made: Figure = optional("matplotlib.figure", "Drawing").Figure(
        figsize=(width, height), layout=layout
    )
    return made


# Without dates and versions, so that equal runs give equal files.
_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
}


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as ``name``.png and .svg to a folder, created if missing; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{name}.{suffix}" for suffix in ("png", "svg")]
    with look():
        for file in files:
            figure.savefig(file, dpi=DPI, metadata=_METADATA.get(file.suffix))
    return files
