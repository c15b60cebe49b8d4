# SPDX-License-Identifier: Apache-2.0
"""A run with its pictures: what `simulate` returns, and what `Run` adds a bag to."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tactile_hand_ros.report.figures import motion_figure
from tactile_hand_ros.report.page import write_report
from tactile_hand_ros.run.result import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Result(RunData):
    """A run: `record`, `metrics`, `events`, `assumptions`, `to_pandas()`, `plot()`, `report()`."""

    def plot(self) -> Figure:
        """Return the paper's Fig. 3 of this run: rates, position, orientation error, forces.

        Raises:
            MissingLibraryError: If matplotlib is not installed.
        """
        return motion_figure(self.record)

    def report(self, folder: Path | str | None = None) -> Path:
        """Write ``report.html`` and return the file.

        Args:
            folder: Where to; by default the run's folder, or the present one without a bag.

        Raises:
            TactileHandError: If the file cannot be written.
        """
        return write_report(self, None if folder is None else Path(folder))
