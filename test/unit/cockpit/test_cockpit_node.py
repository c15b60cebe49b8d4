# SPDX-License-Identifier: Apache-2.0
"""The cockpit shows the nodes of its own hand, and says what it needs."""

import json
import sys

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.parameter import Parameter
from support.recorded import random_record, write_record

from tactile_hand_ros.cockpit.node import CockpitNode
from tactile_hand_ros.extras import MissingLibraryError
from tactile_hand_ros.ros.diagnostics import ERROR, WARN
from tactile_hand_ros.run.run import Run
from tactile_hand_ros.scenario.scenario import load_scenario, resolved


@pytest.mark.parametrize(
    ("namespace", "name"), [("", "/plant"), ("/left", "/left/plant"), ("/left/a", "/left/a/plant")]
)
def test_it_shows_its_own_hand_where_several_share_the_diagnostics(here, namespace, name):
    cockpit = CockpitNode(context=here.context, namespace=namespace)
    here.add(cockpit)
    others = {"/plant", "/left/plant", "/left/a/plant", "/leftover/plant"} - {name}
    told = [
        DiagnosticStatus(name=each, level=level, values=[KeyValue(key=key, value=each)])
        for each, level, key in [(name, WARN, "A1"), *((other, ERROR, "A2") for other in others)]
    ]
    here.send("/diagnostics", DiagnosticArray(status=told))
    here.wait(lambda: cockpit.status["nodes"])
    assert [(node["name"], node["level"]) for node in cockpit.status["nodes"]] == [("plant", 1)]
    assert cockpit.status["margins"] == {"A1": name}


def test_a_saved_recording_has_a_report_and_is_not_judged_by_a_goal(here, tmp_path):
    written = {"scenario": resolved(load_scenario("paper"))}
    bag = write_record(tmp_path / "run" / "bag", random_record(), custom_data=written)
    overrides = [Parameter("bag", value=str(bag))]
    cockpit = CockpitNode(context=here.context, parameter_overrides=overrides)
    here.add(cockpit)
    replies = []
    cockpit.submit({"do": "save", "last": 0}, lambda *reply: replies.append(reply))
    saved = tmp_path / "run" / "saved-1"
    here.wait(lambda: replies, "the reply")
    assert replies == [(True, f"saved in {saved}")] and (saved / "report.html").is_file()
    assert json.loads((saved / "summary.json").read_text())["interactive"] is True
    assert Run(bag).metrics.goal_reached is False and Run(saved).metrics.goal_reached is None


class Missing:
    """An import finder that finds no aiohttp."""

    def find_spec(self, name, *_):
        if name == "aiohttp":
            raise ModuleNotFoundError(name=name)


def test_without_its_library_it_says_what_to_install(here, monkeypatch):
    for module in ("aiohttp", "aiohttp.web"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    with pytest.raises(MissingLibraryError, match="The cockpit needs .* `pip install aiohttp`"):
        CockpitNode(context=here.context)
