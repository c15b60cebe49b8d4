# SPDX-License-Identifier: Apache-2.0
"""`make bench` as a command: what it saves, draws and refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from bench.__main__ import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Return the one sentence with which a command is refused."""
    assert main([str(a) for a in arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1 and "Traceback" not in printed.err
    return printed.err


def test_bench_saves_its_results_and_compares_with_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results" / "bench.json"
    words = ["--blocks", "--ticks", "20", "--repeats", "1", "--out", str(out)]
    assert main(words) == 0
    assert "when the saved run was made" not in capsys.readouterr().out
    assert json.loads(out.read_text())["results"]
    assert main(words) == 0
    page = capsys.readouterr().out
    assert "closed loop" in page and "when the saved run was made" in page
    assert re.search(r"controller, one tick .* \d+\.\d\d x", page)
    assert max(map(len, page.splitlines())) <= 100


def test_bench_refuses_a_folder_before_it_measures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "is a folder, expected the name of a file" in refused(capsys, "--out", tmp_path)


def test_bench_draws_the_cost_against_size(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--sizes", "--ticks", "2", "--repeats", "1", "--format", "png"]
    out = ["--out", str(tmp_path / "bench" / "sizes.json")]
    assert main([*words, *out, "--figures", str(tmp_path)]) == 0
    assert "5 fingers of 6 joints" in " ".join(capsys.readouterr().out.split())
    assert {file.name for file in tmp_path.iterdir()} == {"sizes.png", "bench"}


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--realtime", "--seconds", "0"], "--seconds"),
        (["--realtime", "--rates", "500,fast"], "--rates is '500,fast'"),
        (["--realtime", "--sizes"], "measured separately"),
        (["--scenarios", "no_such", "--runs", "1"], "no_such"),
    ],
)
def test_bench_refuses_what_it_cannot_measure(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refused(capsys, "--out", str(tmp_path / "x"), *words)
