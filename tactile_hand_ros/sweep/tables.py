# SPDX-License-Identifier: Apache-2.0
"""The results of a sweep as tables and as a page of Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from tactile_hand_ros import files
from tactile_hand_ros.report import tables
from tactile_hand_ros.sweep.results import Results

SUMMARY = "summary.md"
FRACTION_COLUMNS = ("scenario", "outcome", "runs", "fraction", "95 % interval")
EFFECT_COLUMNS = ("scenario", "parameter", "metric", "rank correlation", "95 % interval")
METRIC_COLUMNS = ("scenario", "metric", "runs", "median", "95 % interval")


def fraction_rows(results: Sequence[Results]) -> list[list[str]]:
    """Return outcomes as text, columns as in `FRACTION_COLUMNS`."""
    return [
        [
            _name(each),
            outcome,
            f"{count} of {runs}",
            _percent(fraction[0]),
            _span(fraction, _percent),
        ]
        for each in results
        for outcome, count, runs, fraction in each.fractions()
    ]


def metric_rows(results: Sequence[Results]) -> list[list[str]]:
    """Return metrics as text, columns as in `METRIC_COLUMNS`."""
    return [
        [_name(each), metric, str(count), _number(median[0]), _span(median, _number)]
        for each in results
        for metric, count, median in each.medians()
    ]


def effect_rows(results: Sequence[Results]) -> list[list[str]]:
    """Return sensitivities as text, the strongest first; what is unknown is left out."""
    rows = []
    for each in results:
        known = [effect for effect in each.effects() if not math.isnan(effect.value)]
        for e in sorted(known, key=lambda effect: -abs(effect.value)):
            interval = _span((e.value, e.low, e.high), _number)
            rows.append([_name(each), e.parameter, e.metric, _number(e.value), interval])
    return rows


def write(results: Sequence[Results], folder: Path, pictures: Sequence[Path]) -> Path:
    """Write the summary of a sweep with its figures; return the file."""
    sweep = results[0].sweep
    text = [
        f"# {', '.join(sweep.scenarios)} over {', '.join(sweep.space.parameters)}\n",
        f"{sweep.runs} runs asked for, sampler {sweep.sampler}, seed {sweep.seed}. Each row of "
        "`runs.parquet` and `runs.csv` is a run.\n",
        tables.markdown(FRACTION_COLUMNS, fraction_rows(results)),
        tables.markdown(METRIC_COLUMNS, metric_rows(results)),
        tables.markdown(EFFECT_COLUMNS, effect_rows(results)),
        *(f"![{picture.stem}]({picture.name})\n" for picture in pictures),
    ]
    files.replace_text(folder / SUMMARY, "\n".join(text))
    return folder / SUMMARY


def _name(results: Results) -> str:
    return results.scenario or next(iter(results.sweep.scenarios))


def _number(value: float) -> str:
    return "unknown" if math.isnan(value) else f"{value:.3g}"


def _percent(value: float) -> str:
    return "unknown" if math.isnan(value) else f"{100 * value:.1f} %"


def _span(values: tuple[float, float, float], text: Callable[[float], str]) -> str:
    return "" if math.isnan(values[0]) else f"{text(values[1])} to {text(values[2])}"
