# SPDX-License-Identifier: Apache-2.0
"""Fuzzing finds what dies and hangs, keeps it, and finds it again."""

import pytest

from studies.fuzz import fuzz as fuzz_module
from studies.fuzz.fuzz import chance_of, fuzz, replay
from studies.fuzz.targets import Target, reading_targets
from tactile_hand_ros.errors import ConfigurationError, MessageError


def dies(data):
    if data[0] < 20:
        raise ZeroDivisionError("as it happens")
    raise MessageError("refused")


def hangs(data):
    while data[0] < 40:
        pass


def target(read):
    return Target(lambda chance: chance.randbytes(4), read)


def test_our_readers_survive_a_second_of_it(tmp_path):
    with reading_targets() as targets:
        report = fuzz(targets, 1.0, 7, tmp_path)
    assert not report.findings and not report.grew
    assert report.inputs["wire joints"] >= 40 and sum(report.refused.values()) > 100


def test_a_death_is_found_kept_and_found_again(tmp_path):
    targets = {"mine": target(dies)}
    report = fuzz(targets, 0.05, 1, tmp_path)
    assert report.findings and report.refused["mine"]
    first = report.findings[0]
    assert first["what"] == "death: ZeroDivisionError: as it happens"
    kept = next(tmp_path.glob("mine-1-*.bin"))
    assert "ZeroDivisionError" in replay(targets, kept)
    assert (
        targets["mine"].make(chance_of(1, "mine", first["number"]))
        == kept.parent.joinpath(f"mine-1-{first['number']}.bin").read_bytes()
    )
    with pytest.raises(ConfigurationError, match="there is no target 'mine'"):
        replay({}, kept)
    with pytest.raises(ConfigurationError, match="are needed to replay"):
        replay(targets, tmp_path / "other.bin")


def test_a_hang_is_interrupted_and_found(tmp_path, monkeypatch):
    monkeypatch.setattr(fuzz_module, "LONGEST", 0.05)
    report = fuzz({"slow": target(hangs)}, 0.3, 1, tmp_path)
    assert any(found["what"].startswith("hang") for found in report.findings)
