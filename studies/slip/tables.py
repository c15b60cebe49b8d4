# SPDX-License-Identifier: Apache-2.0
"""The slip study as tables and data."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from studies.slip.cases import EVENTS
from studies.slip.outcomes import HELD
from studies.slip.study import Study
from tactile_hand_ros.report import tables
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.sweep.statistics import estimate, share

COLUMNS = ("", "runs", "median", "95 % interval", "90 %", "99 %", "goal")
SHARE_COLUMNS = ("", "runs", "share", "95 % interval")


def rows(study: Study) -> list[list[str]]:
    """Return the results as text, columns as in `COLUMNS`."""
    slipped = [o for o in study.outcomes if not math.isnan(o.onset)]
    fast = [o for o in slipped if o.case.rate == 1000.0]
    prompt = [o for o in fast if o.case.latency <= 0.002]
    out = []
    for name, some in (("", slipped), (", 1 kHz", fast), (", 1 kHz, latency < 2 ms", prompt)):
        out.append(_row(f"detection{name}", [1e3 * o.detection for o in some], "ms", "< 10 ms"))
    for name, some in (("", slipped), (", 1 kHz", fast), (", 1 kHz, latency < 2 ms", prompt)):
        out.append(_row(f"reaction{name}", [1e3 * o.reaction for o in some], "ms", "< 20 ms"))
    for event in EVENTS:
        some = [o for o in slipped if o.case.event == event and o.survivable]
        out.append(_row(f"slip distance, {event}", [1e3 * o.slip for o in some], "mm", ""))
    pulls = [1e3 * o.slip for o in study.pulls]
    out.append(_row("slip distance, 10 N on 0.2 kg, mu 0.5", pulls, "mm", "< 1 mm"))
    out.append(_row("largest squeeze / least", [o.peak for o in slipped if o.survivable], "", ""))
    for kind in HELD:
        ratios = [h.ratio for h in study.held if h.kind == kind]
        out.append(_row(f"steady squeeze / least, mu {kind}", ratios, "", "< 1.4"))
    return out


def _row(name: str, values: Sequence[float], unit: str, goal: str) -> list[str]:
    e = estimate(values)
    interval = f"{_text(e.low)} to {_text(e.high)}"
    numbers = [f"{_text(e.median)} {unit}".rstrip(), interval, _text(e.p90), _text(e.p99)]
    return [name, str(e.count), *numbers, goal]


def _text(value: float) -> str:
    return "never" if math.isinf(value) else tables.number(float(f"{value:.3g}"))


def share_rows(study: Study) -> list[list[str]]:
    """Return what happened how often, columns as in `SHARE_COLUMNS`."""
    slipped = [o for o in study.outcomes if not math.isnan(o.onset)]
    survivable = [o for o in study.outcomes if o.survivable]
    in_time = [o for o in survivable if o.in_time]
    flags = {
        "slipped": [not math.isnan(o.onset) for o in study.outcomes],
        "alarm within 10 ms of slipping": [o.detection <= 0.01 for o in slipped],
        "alarm at all after slipping": [math.isfinite(o.detection) for o in slipped],
        "squeeze rose within 20 ms of slipping": [o.reaction <= 0.02 for o in slipped],
        "no alarm without slip before the event": [o.false_alarms == 0 for o in study.outcomes],
        "slid before the event": [o.early_slip > 1e-5 for o in study.outcomes],
        "a grasp inside the crush limit can survive": [o.survivable for o in study.outcomes],
        "survivable: lost": [o.lost for o in survivable],
        "survivable: also by a hand told so late": [o.in_time for o in survivable],
        "survivable in time: lost": [o.lost for o in in_time],
        "survivable: at rest in the end": [o.caught for o in survivable],
        "survivable: slid less than 1 mm": [o.slip < 1e-3 for o in survivable],
    }
    return [
        [name, str(len(values)), *_share_texts(*share(values))] for name, values in flags.items()
    ]


def _share_texts(value: float, low: float, high: float) -> tuple[str, str]:
    return f"{100 * value:.1f} %", f"{100 * low:.1f} to {100 * high:.1f} %"


def write(study: Study, folder: Path) -> list[Path]:
    """Write all runs as JSON and the tables as Markdown; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    report, data = folder / "study_slip.md", folder / "study_slip.json"
    text = [
        f"# Slip study: {len(study.outcomes)} runs, seed {study.seed}\n",
        tables.markdown(COLUMNS, rows(study)),
        tables.markdown(SHARE_COLUMNS, share_rows(study)),
    ]
    report.write_text("\n".join(text), encoding="utf-8")
    data.write_text(json.dumps(json_ready(asdict(study)), indent=1) + "\n", encoding="utf-8")
    return [report, data]
