# SPDX-License-Identifier: Apache-2.0
"""The directory of one run: scenario, parameters, logs and results."""

from __future__ import annotations

import contextlib
import datetime
import re
from pathlib import Path

from tactile_hand_ros.config.model import Config
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.files import replace_link
from tactile_hand_ros.ros.parameters import to_params_yaml
from tactile_hand_ros.scenario.scenario import Scenario, resolved


class RunDirectory:
    """``<root>/<time>-<scenario>/`` and its files; the scenario has every value resolved."""

    def __init__(self, path: Path) -> None:
        """Name the files in a directory."""
        self.path, self.bag = path, path / "bag"
        self.summary, self.scenario = path / "summary.json", path / "scenario.yaml"

    @classmethod
    def create(cls, root: Path, name: str, now: datetime.datetime | None = None) -> RunDirectory:
        """Create a new directory below `root` and let ``<root>/latest`` point to it.

        Its name contains the scenario's `name` and the local time.
        """
        tame = re.sub(r"[^\w.-]+", "_", name)
        stem = f"{now or datetime.datetime.now():%Y%m%d-%H%M%S}-{tame}"
        run, number = cls(root / stem), 1
        try:
            root.mkdir(parents=True, exist_ok=True)
            while not _make(run.path):  # a second run in the same second gets a number
                number += 1
                run = cls(root / f"{stem}-{number}")
            (run.path / "logs").mkdir(mode=0o700)  # one of them has the link of the cockpit
            (run.path / "parameters").mkdir()
            with contextlib.suppress(PermissionError):  # a file system without links
                replace_link(root / "latest", run.path.name)
        except OSError as error:
            raise ConfigurationError(
                f"no run can be stored in '{root}': {error.strerror}; choose another --out"
            ) from None
        return run

    def log(self, node: str) -> Path:
        """Return the file for the output of a node."""
        return self.path / "logs" / f"{node}.log"

    def write_scenario(self, scenario: Scenario) -> str:
        """Write the scenario with every value resolved and return its text."""
        text = resolved(scenario)
        self.scenario.write_text(text, encoding="utf-8")
        return text

    def write_parameters(self, node: str, config: Config) -> Path:
        """Write the parameters of a node as a file for ``--params-file``."""
        path = self.path / "parameters" / f"{node}.yaml"
        path.write_text(to_params_yaml(config, node), encoding="utf-8")
        return path


def _make(folder: Path) -> bool:
    """Create a folder and return whether it is new."""
    with contextlib.suppress(FileExistsError):
        folder.mkdir()
        return True
    return False
