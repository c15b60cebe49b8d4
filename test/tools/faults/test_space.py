# SPDX-License-Identifier: Apache-2.0
"""The sample of a campaign is balanced, reproducible and in the order of its nodes."""

import itertools
from collections import Counter
from dataclasses import replace

import pytest

from studies import __main__ as studies
from studies.faults import space
from tactile_hand_ros.errors import ConfigurationError


@pytest.mark.parametrize("runs", [1, 37, 2000])
def test_no_cell_comes_twice_more_often_than_another(runs):
    drawn = space.sample(runs, 3, space.cells())
    counts = Counter((run.way, run.situation, run.component, run.fault) for run in drawn)
    assert len(drawn) == runs and max(counts.values()) - min(counts.values()) <= 1
    assert len(set(drawn)) == runs
    assert drawn == space.sample(runs, 3, space.cells()) != space.sample(runs, 4, space.cells())
    sessions = [key for key, _ in itertools.groupby(drawn, lambda run: (run.way, run.situation))]
    assert len(sessions) == len(set(sessions))


@pytest.mark.parametrize(("option", "given"), [("way", "paper"), ("hand", "composed")])
def test_an_option_of_the_other_list_is_refused(tmp_path, option, given):
    with pytest.raises(ConfigurationError, match=f"--{option} {given} is unknown; choose from"):
        studies.faults(tmp_path / "out", **{option: [given]})
    assert not list(tmp_path.iterdir())


def test_every_fault_of_every_component_has_its_cells():
    known = space.cells()
    assert len(known) == len(set(known)) > 300
    for component, faults in space.FAULTS_OF.items():
        found = {cell.fault for cell in known if cell.component == component}
        assert found - {"none"} == set(faults)


def test_a_node_is_killed_only_where_it_is_a_process():
    for cell in space.cells():
        if cell.component in space.HAND and cell.fault in space.DEADLY:
            assert cell.way in ("lockstep", "processes") or cell.fault == "off"
    killed = space.Injection("processes", "moving", "sensor", "stopped")
    assert killed in space.cells() and replace(killed, way="composed") not in space.cells()
