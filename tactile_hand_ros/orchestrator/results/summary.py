# SPDX-License-Identifier: Apache-2.0
"""The results of a run as JSON."""

from __future__ import annotations

import datetime
import json

from tactile_hand_ros.bag.provenance import versions
from tactile_hand_ros.files import replace_text
from tactile_hand_ros.orchestrator.results.judgement import GoalVerdict
from tactile_hand_ros.orchestrator.results.reading import Results, deadlines_of
from tactile_hand_ros.orchestrator.run_directory import RunDirectory
from tactile_hand_ros.orchestrator.session import Plan, RunOutcome
from tactile_hand_ros.run.metrics import json_ready


def write_summary(
    plan: Plan, directory: RunDirectory, outcome: RunOutcome, results: Results, verdict: GoalVerdict
) -> None:
    """Write ``summary.json`` whole or not at all."""
    scenario, deadlines = plan.scenario, deadlines_of(plan, outcome)
    content = {
        "scenario": scenario.name,
        "outcome": verdict.outcome,
        "exit_code": verdict.exit_code,
        "reasons": verdict.reasons,
        "goal": {
            "position_error_m": scenario.goal.position_error,
            "rotation_error_rad": scenario.goal.rotation_error,
            "slip_distance_m": scenario.goal.slip_distance,
        },
        "metrics": results.metrics,
        "assumptions": results.assumptions,
        "recoveries": results.recoveries,
        "recording": results.recording,
        "real_time": None if deadlines is None else deadlines.to_dict(),
        "startup_s": outcome.startup,
        "seed": scenario.seed,
        "pacing": scenario.plant.pacing,
        "namespace": plan.namespace,
        "interactive": plan.interactive,
        "finished_at": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "versions": versions(),
    }
    text = json.dumps(json_ready(content), indent=2, allow_nan=False)
    replace_text(directory.summary, text + "\n")
