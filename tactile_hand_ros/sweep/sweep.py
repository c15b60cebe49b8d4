# SPDX-License-Identifier: Apache-2.0
"""A sweep as a study: scenarios over ranges of their parameters, measured run by run."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tactile_hand_ros
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.compiled import ensure_compiled
from tactile_hand_ros.config.explanation import did_you_mean, unit_of
from tactile_hand_ros.config.model import leaves, validate
from tactile_hand_ros.control.own_law import take_law
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.run.metrics import metrics
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, plain
from tactile_hand_ros.sweep.engine import Point, Study
from tactile_hand_ros.sweep.metrics import measures, outcome
from tactile_hand_ros.sweep.space import (
    SAMPLERS,
    Choice,
    Parameter,
    Range,
    Space,
    parse_parameter,
)
from tactile_hand_ros.sweep.table import LAST_COLUMNS, Store, Tally, keep, read_description

SCENARIO, SEED = "scenario", "seed"


@dataclass(frozen=True)
class Trial:
    """Makes one run of a sweep: a scenario with some values changed, through the closed loop.

    Attributes:
        scenarios: Plain data of each scenario by name, as `plain` gives it.
        metrics: What is asked, see `measures`.
    """

    scenarios: Mapping[str, Mapping[str, Any]]
    metrics: tuple[str, ...]

    def scenario(self, point: Point) -> Scenario:
        """Return the scenario of a run.

        Raises:
            ConfigurationError: If a value is refused.
        """
        name, changes = self.changes(point)
        data = json.loads(json.dumps(self.scenarios[name]))
        for path, value in changes.items():
            _put(data, path, value)
        return validate(Scenario, data, f"run {point.index}")

    def changes(self, point: Point) -> tuple[str, dict[str, Any]]:
        """Return the scenario's name and the values over it, the run's seed among them."""
        values = {SEED: point.seed, **point.values}
        name = str(values.pop(SCENARIO, next(iter(self.scenarios))))
        return name, values

    def __call__(self, point: Point) -> dict[str, Any]:
        """Make a run and return what was asked of it."""
        _compile_once()
        scenario = self.scenario(point)
        take_law(scenario.manipulation_controller.law)  # named by the user of the sweep
        record = ClosedLoop(scenario).run()
        found = metrics(record, scenario)
        asked = measures(self.metrics)
        numbers = {name: measure(record, scenario, found) for name, measure in asked.items()}
        return {**numbers, "outcome": outcome(record, found)}


@functools.cache
def _compile_once() -> None:
    ensure_compiled()


@dataclass(frozen=True)
class Sweep:
    """What the user asked for.

    Attributes:
        scenarios: Plain data of each scenario by name, with what stays fixed.
        over: Parameters as on the command line.
        sampler: Name of one of `SAMPLERS`.
        runs: Number of runs.
        seed: Of the sampler and of all runs.
        metrics: What is asked of each run.
    """

    scenarios: Mapping[str, Mapping[str, Any]]
    over: tuple[str, ...]
    sampler: str
    runs: int
    seed: int
    metrics: tuple[str, ...]

    @functools.cached_property
    def space(self) -> Space:
        """What is varied; several scenarios are a choice as well."""
        names = tuple(self.scenarios)
        found: dict[str, Parameter] = {SCENARIO: Choice(names)} if len(names) > 1 else {}
        first = self.scenarios[names[0]]
        for text in self.over:
            path = text.partition("=")[0]
            present = _get(first, path) if "=" in text else None
            is_whole = isinstance(present, int) and not isinstance(present, bool)
            path, found[path] = parse_parameter(text, is_whole=is_whole)
        return Space(found)

    @property
    def trial(self) -> Trial:
        """What makes a run."""
        return Trial(self.scenarios, self.metrics)

    def check(self) -> None:
        """Try both ends of every parameter in every scenario, before anything is run.

        Raises:
            ConfigurationError: If a path is unknown, a range empty or a value refused.
        """
        measures(self.metrics)
        if self.sampler not in SAMPLERS:
            hint = did_you_mean(self.sampler, SAMPLERS)
            raise ConfigurationError(f"--sampler is '{self.sampler}'{hint}")
        for name in self.scenarios:
            for path, parameter in self.space.parameters.items():
                if path != SCENARIO:
                    self._try_ends(name, path, parameter)

    def _try_ends(self, name: str, path: str, parameter: Parameter) -> None:
        ends = map(parameter.value, (0.0, 1.0))
        for value in parameter.values if isinstance(parameter, Choice) else ends:
            data = json.loads(json.dumps(self.scenarios[name]))
            _put(data, path, value)
            try:
                validate(Scenario, data, f"--over {path}")
            except ConfigurationError as error:  # once for each node that fractions the value
                raise ConfigurationError(str(error).splitlines()[0]) from None

    def description(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "version": tactile_hand_ros.__version__,
            "sampler": self.sampler,
            "runs": self.runs,
            "seed": self.seed,
            "over": list(self.over),
            "metrics": list(self.metrics),
            "scenarios": dict(self.scenarios),
        }

    @property
    def study(self) -> Study:
        """The sweep as a study."""
        return Study(self.space, self.sampler, self.trial, self.runs, self.seed)

    def carry_out(self, folder: Path, watch: Callable[[Tally], None] = lambda _: None) -> Tally:
        """Make all runs that are not done yet and write the table of all that are.

        Args:
            folder: Of the results; holds those of an earlier, unfinished call.
            watch: Called after each run.

        Raises:
            StudyError: If the folder holds another study or cannot be written, or processes die.
        """

        def parameters(point: Point) -> dict[str, Any]:
            name, changes = self.trial.changes(point)
            return {SCENARIO: name, **changes}

        return keep(self.study, self._store(folder), self.description(), parameters, watch)

    def _store(self, folder: Path) -> Store:
        """Return the folder of its results."""
        units = {path: unit_of(field) for path, field in leaves(Scenario).items()}
        columns: dict[str, type] = {SCENARIO: str, SEED: int}
        columns |= {path: _kind(p) for path, p in self.space.parameters.items()}
        columns |= {name: float for name in measures(self.metrics)}
        return Store(folder, {**columns, **LAST_COLUMNS}, units)


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
    made = Sweep(data, tuple(over), sampler or "grid", runs, seed, tuple(metrics))
    ranges = any(isinstance(p, Range) for p in made.space.parameters.values())
    if not sampler and ranges:
        made = Sweep(data, tuple(over), "latin", runs, seed, tuple(metrics))
    made.check()
    return made


def read_sweep(folder: Path) -> Sweep:
    """Return the sweep whose results a folder holds.

    Raises:
        StudyError: If it holds none.
    """
    found = read_description(folder)
    return Sweep(
        found["scenarios"],
        tuple(found["over"]),
        found["sampler"],
        found["runs"],
        found["seed"],
        tuple(found["metrics"]),
    )


def _kind(parameter: Parameter) -> type:
    """Return the type of a parameter's column."""
    if isinstance(parameter, Range):
        return int if parameter.is_whole else float
    kinds = {type(value) for value in parameter.values}
    if kinds == {bool} or kinds == {int}:
        return kinds.pop()
    return float if kinds <= {int, float} else str


def _get(data: Any, path: str) -> Any:
    """Return the value at a path; a number in it counts the items of a list from 0.

    Raises:
        ConfigurationError: If there is none.
    """
    for key in path.split("."):
        if isinstance(data, Mapping) and key in data:
            data = data[key]
        elif isinstance(data, list) and key.isdigit() and int(key) < len(data):
            data = data[int(key)]
        else:
            hint = did_you_mean(path, leaves(Scenario))
            raise ConfigurationError(f"--over names the unknown parameter '{path}'{hint}")
    return data


def _put(data: Any, path: str, value: Any) -> None:
    *parents, last = path.split(".")
    place = _get(data, ".".join(parents)) if parents else data
    _get(place, last)
    place[int(last) if isinstance(place, list) else last] = value
