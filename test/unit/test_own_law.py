# SPDX-License-Identifier: Apache-2.0
"""User laws: found next to the scenario, checked, and never imported from a bag."""

import sys
from pathlib import Path

import numpy as np
import pytest

from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.config.model import validate
from tactile_hand_ros.config.plain_yaml import parse_yaml
from tactile_hand_ros.control.laws import law_of
from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.scenario.preflight import check_scenario
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario, resolved

LAW = """
from tactile_hand_ros.control.laws import OptimalLaw

class MyLaw(OptimalLaw):
    gain = 1.0

    def internal_torque(self):
        return self.gain * super().internal_torque()
"""


def write(folder: Path, law: str = LAW, scenario: str = "law: my_law:MyLaw") -> str:
    folder.mkdir(exist_ok=True)
    (folder / "my_law.py").write_text(law)
    (folder / "mine.yaml").write_text(f"extends: paper\n{scenario}\n")
    return str(folder / "mine.yaml")


@pytest.mark.parametrize(
    "scenario", ["law: my_law:MyLaw", "manipulation_controller: {law: {name: my_law:MyLaw}}"]
)
def test_a_law_beside_the_scenario_runs_and_keeps_the_gains(tmp_path, scenario):
    mine = load_scenario(write(tmp_path / "a", scenario=scenario))
    check_scenario(mine)
    assert mine.manipulation_controller.law.k_p == 3.0
    ran, paper = ClosedLoop(mine).run(5), ClosedLoop(load_scenario("paper")).run(5)
    np.testing.assert_array_equal(ran.command, paper.command)


def test_a_law_is_found_on_the_path_and_in_the_working_directory(tmp_path, monkeypatch):
    write(tmp_path / "a")
    (tmp_path / "a" / "my_law.py").rename(tmp_path / "a" / "law_on_path.py")
    monkeypatch.chdir(tmp_path / "a")
    chosen = {"law": "law_on_path:MyLaw"}
    assert load_scenario("paper", chosen).manipulation_controller.law.folder == str(tmp_path / "a")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path / "a"))
    assert load_scenario("paper", chosen).manipulation_controller.law.folder == ""


def test_a_recorded_configuration_imports_nothing(tmp_path):
    mark = tmp_path / "imported"
    file = write(tmp_path / "a", LAW + f"open({str(mark)!r}, 'w').close()\n")
    text = resolved(load_scenario("paper")).replace(
        "name: optimal\n    folder: ''", f"name: my_law:MyLaw\n    folder: {Path(file).parent}"
    )
    assert "my_law:MyLaw" in text
    recorded = validate(Scenario, parse_yaml(text))  # as `Run.scenario` reads it
    with pytest.raises(ConfigurationError, match="name it yourself: --law my_law:MyLaw"):
        ClosedLoop(recorded)
    with pytest.raises(ConfigurationError, match="name it yourself"):
        ClosedLoop(recorded.changed({"seed": 2}))
    assert not mark.exists()
    load_scenario(file)
    assert mark.exists()


@pytest.mark.parametrize(
    ("name", "law", "message"),
    [
        ("nowhere:MyLaw", LAW, "there is no module 'nowhere'; expected it next to the scenario"),
        ("my_law:Mine", LAW, "its module has no 'Mine'"),
        ("my_law:MyLaw", "import missing_thing", "it needs the module 'missing_thing'"),
        ("my_law:MyLaw", "1 / 0", "its module fails with ZeroDivisionError: division by zero"),
        ("my_law:MyLaw", "MyLaw = 3", "it is a int; expected a class"),
        ("json:MyLaw", LAW, "'json' is a module of Python itself"),
        ("my_law:MyLaw", "class MyLaw:\n  drive = 3", "it has no internal_torque"),
        (
            "my_law:MyLaw",
            "class MyLaw:\n  def internal_torque(self): pass",
            r"it has no drive; expected drive\(self, wrench\)",
        ),
    ],
)
def test_what_is_no_law_is_refused(tmp_path, name, law, message):
    file = write(tmp_path / "a", law, f"law: {name}")
    with pytest.raises(ConfigurationError, match=f"'{name}'.*{message}"):
        load_scenario(file)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (
            "internal_torque(self): return 3.0",
            r"returns 3.0 from internal_torque\(\); expected an array of 9 finite",
        ),
        ("internal_torque(self): return [1.0] * 2", "array of 9 finite torques"),
        ("internal_torque(self): return self.lost", "first tick with AttributeError: .*lost"),
        ("drive(self): pass", "fails at the first tick with TypeError"),
        ("__init__(self, config): pass", "fails at the first tick with TypeError"),
    ],
)
def test_a_law_without_torques_is_refused_before_it_holds_anything(tmp_path, method, message):
    scenario = load_scenario(write(tmp_path / "a", f"{LAW}\n    def {method}\n"))
    with pytest.raises(ConfigurationError, match=message):
        check_scenario(scenario)


def test_a_law_may_be_in_a_package_and_leaves_the_path_as_it_was(tmp_path):
    package = tmp_path / "my_laws"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "gentle.py").write_text(LAW)
    (tmp_path / "optimal.py").write_text("1 / 0")  # no law that a scenario names
    file, path = tmp_path / "mine.yaml", list(sys.path)
    file.write_text("extends: paper\nlaw: my_laws.gentle:MyLaw\n")
    law = load_scenario(str(file)).manipulation_controller.law
    assert (law.name, law.folder) == ("my_laws.gentle:MyLaw", str(tmp_path))
    assert sys.path == path
    for missing in ("my_laws.harsh", "none_of.these"):
        file.write_text(f"extends: paper\nlaw: {missing}:MyLaw\n")
        with pytest.raises(ConfigurationError, match=f"there is no module '{missing}'"):
            load_scenario(str(file))
        assert sys.path == path
    file.write_text("extends: paper\nlaw: optimal\n")
    assert load_scenario(str(file)).manipulation_controller.law.folder == ""


def test_a_law_of_another_folder_is_imported_with_all_modules_of_its_package(tmp_path):
    configs = []
    for folder, gain in (("one", "1.0"), ("two", "2.0")):
        package = tmp_path / folder / "twin_laws"
        package.mkdir(parents=True)
        (package / "__init__.py").touch()
        (package / "gains.py").write_text(f"GAIN = {gain}")
        law = LAW.replace("gain = 1.0", "gain = GAIN").replace(
            "import OptimalLaw", "import OptimalLaw\nfrom twin_laws.gains import GAIN"
        )
        (package / "gentle.py").write_text(law)
        file = package.parent / "mine.yaml"
        file.write_text("extends: paper\nlaw: twin_laws.gentle:MyLaw\n")
        configs.append(load_scenario(str(file)).manipulation_controller.law)
    assert [law_of(config).gain for config in configs] == [1.0, 2.0]
