# SPDX-License-Identifier: Apache-2.0
"""A sweep as a study: scenarios over ranges of their parameters, measured run by run."""

from __future__ import annotations

import copy
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
from tactile_hand_ros.sweep.space import SAMPLERS, Choice, Parameter, Range, Space, parse_parameter
from tactile_hand_ros.sweep.table import Tally, keep, read_description

SCENARIO, SEED = "scenario", "seed"


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
        scenarios: Plain data of each scenario by name, with what stays fixed.
    """

    sampler: str
    runs: int
    seed: int
    over: Sequence[str]
    metrics: Sequence[str]
    scenarios: Mapping[str, Mapping[str, Any]]

    @functools.cached_property
    def space(self) -> Space:
        """What is varied; several scenarios are a choice as well."""
        names = tuple(self.scenarios)
        found: dict[str, Parameter] = {SCENARIO: Choice(names)} if len(names) > 1 else {}
        for text in self.over:
            path, is_given, _ = text.partition("=")
            present = _find(self.scenarios[names[0]], path)[2] if is_given else None
            is_whole = isinstance(present, int) and not isinstance(present, bool)
            path, found[path] = parse_parameter(text, is_whole=is_whole)
        return found

    @property
    def study(self) -> Study:
        """The sweep as a study."""
        return Study(self.space, self.sampler, self, self.runs, self.seed)

    def __call__(self, point: Point) -> dict[str, Any]:
        """Make a run and return what was asked of it."""
        _compile_once()
        scenario = self.scenario(point)
        take_law(scenario.manipulation_controller.law)  # named by the user of the sweep
        return measured(scenario, self.metrics)

    def scenario(self, point: Point) -> Scenario:
        """Return the scenario of a run.

        Raises:
            ConfigurationError: If a value is refused.
        """
        values = {SEED: point.seed, **point.values}
        name = values.pop(SCENARIO, next(iter(self.scenarios)))
        return self._changed(name, values, f"run {point.index}")

    def _changed(self, name: str, values: Mapping[str, Any], source: str) -> Scenario:
        data = copy.deepcopy(self.scenarios[name])
        for path, value in values.items():
            container, key, _ = _find(data, path)
            container[key] = value
        return validate(Scenario, data, source)

    def check(self) -> None:
        """Try both ends of every parameter in every scenario, before anything is run.

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
                for name in self.scenarios if path != SCENARIO else ():
                    try:
                        self._changed(name, {path: value}, f"--over {path}")
                    except ConfigurationError as error:  # once for each node that has the value
                        raise ConfigurationError(str(error).splitlines()[0]) from None

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
    scenarios: Sequence[str],
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
        scenarios: Names or files.
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
    loaded = [load_scenario(name, fixed) for name in scenarios]
    data = {scenario.name: plain(scenario) for scenario in loaded}
    if len(data) < len(scenarios):
        raise ConfigurationError(f"two of {', '.join(scenarios)} have the same name, rename one.")
    if not over and len(data) < 2:
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


def _find(data: Any, path: str) -> tuple[Any, Any, Any]:
    """Return container, key and value at a path; a number in it counts the items of a list from 0.

    Raises:
        ConfigurationError: If there is none.
    """
    container: Any = None
    key: Any = None
    try:
        for key in path.split("."):
            container, key = data, int(key) if isinstance(data, list) and key.isdigit() else key
            data = container[key]
    except (LookupError, TypeError, ValueError):
        hint = did_you_mean(path, leaves(Scenario))
        raise ConfigurationError(f"--over names the unknown parameter '{path}'{hint}") from None
    return container, key, data
