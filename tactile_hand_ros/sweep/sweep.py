# SPDX-License-Identifier: Apache-2.0
"""A sweep as a study: a scenario over ranges of its parameters, measured run by run."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.config.explanation import did_you_mean
from tactile_hand_ros.config.model import leaves, validate
from tactile_hand_ros.control.own_law import take_law
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, plain
from tactile_hand_ros.sweep.engine import Point, Study, StudyError
from tactile_hand_ros.sweep.metrics import METRICS, measures, outcome
from tactile_hand_ros.sweep.space import SAMPLERS, Choice, Range, Space, parse_parameter
from tactile_hand_ros.sweep.table import Tally, keep, read_description


def measured(scenario: Scenario, asked: Sequence[str]) -> dict[str, Any]:
    """Run a scenario through the closed loop; return what is asked, see `measures`, and outcome."""
    record = ClosedLoop(scenario).run()
    found = metrics(record, scenario)
    numbers = {name: measure(record, scenario, found) for name, measure in measures(asked).items()}
    return {**numbers, "outcome": outcome(record, found)}


_compile_once = functools.cache(ensure_compiled)


@dataclass(frozen=True)
class Sweep:
    """What the user asked for; called with a point, it makes that run.

    Attributes:
        sampler: Name of one of `SAMPLERS`.
        runs: Number of runs.
        seed: Of the sampler and of all runs.
        over: Parameters as on the command line.
        metrics: What is asked of each run, see `measures`.
        scenario: Plain data of the scenario, with what stays fixed.
    """

    sampler: str
    runs: int
    seed: int
    over: Sequence[str]
    metrics: Sequence[str]
    scenario: Mapping[str, Any]

    @functools.cached_property
    def base(self) -> Scenario:
        """The scenario, before anything is varied."""
        return validate(Scenario, self.scenario, "the scenario of the sweep")

    @functools.cached_property
    def space(self) -> Space:
        """What is varied."""
        whole = {path for path, field in leaves(Scenario).items() if field.annotation is int}
        return dict(parse_parameter(each, whole) for each in self.over)

    @property
    def study(self) -> Study:
        """The sweep as a study."""
        return Study(self.space, self.sampler, self, self.runs, self.seed)

    def __call__(self, point: Point) -> dict[str, Any]:
        """Make a run and return what was asked of it."""
        _compile_once()
        scenario = self.scenario_of(point)
        take_law(scenario.manipulation_controller.law)  # named by the user of the sweep
        return measured(scenario, self.metrics)

    def scenario_of(self, point: Point) -> Scenario:
        """Return the scenario of a run.

        Raises:
            ConfigurationError: If a value is refused.
        """
        return self.base.changed({"seed": point.seed, **point.values})

    def check(self) -> None:
        """Try both ends of every parameter, before anything is run.

        Raises:
            ConfigurationError: If a path is unknown, a range empty or a value refused.
        """
        measures(self.metrics)
        if self.sampler not in SAMPLERS:
            hint = did_you_mean(self.sampler, SAMPLERS)
            raise ConfigurationError(f"--sampler is '{self.sampler}'{hint}")
        for path, parameter in self.space.items():
            ends = map(parameter.value, (0.0, 1.0))
            for value in parameter.values if isinstance(parameter, Choice) else ends:
                self.base.changed({path: value})

    def carry_out(self, folder: Path, watch: Callable[[Tally], None] = lambda _: None) -> Tally:
        """Make all runs that are not done yet and write the table of all that are.

        Args:
            folder: Of the results; holds those of an earlier, unfinished call.
            watch: Called after each run.

        Raises:
            StudyError: If the folder holds another study or cannot be written, or processes die.
        """
        return keep(self.study, folder, asdict(self), watch)


def make_sweep(
    scenario: str,
    over: Sequence[str],
    fixed: Mapping[str, Any],
    metrics: Sequence[str],
    *,
    sampler: str = "",
    runs: int = 100,
    seed: int = 0,
) -> Sweep:
    """Return a sweep, checked.

    Args:
        scenario: Name or file.
        over: Parameters, see `parse_parameter`.
        fixed: Values that stay the same, by path.
        metrics: What is asked; everything that has a name by default.
        sampler: Name of one of `SAMPLERS`; by default a grid of choices, a Latin hypercube where
            there is a range.
        runs: Number of runs.
        seed: Of the sampler and of all runs.

    Raises:
        ConfigurationError: If a name, path, range or value cannot be used.
    """
    data = plain(load_scenario(scenario, fixed))
    if not over:
        raise ConfigurationError(
            "nothing is varied; give --over such as --over plant.object.mass=0.05..0.5."
        )
    made = Sweep(sampler or "grid", runs, seed, tuple(over), tuple(metrics or METRICS), data)
    if not sampler and any(isinstance(p, Range) for p in made.space.values()):
        made = replace(made, sampler="latin")
    made.check()
    return made


def read_sweep(folder: Path) -> Sweep:
    """Return the sweep whose results a folder holds.

    Raises:
        StudyError: If it holds none.
    """
    found = read_description(folder)
    try:
        return Sweep(**{field.name: found[field.name] for field in fields(Sweep)})
    except KeyError:
        raise StudyError(f"{folder} holds another kind of study, expected a sweep.") from None
