# SPDX-License-Identifier: Apache-2.0
"""The page's script in the package is built from the source next to it."""

import hashlib
import json
import re
from importlib.resources import files
from pathlib import Path

import pytest

VIEWER = Path(__file__).resolve().parents[2] / "viewer"
FIXED = ("build.mjs", "package.json", "package-lock.json")
PACKAGE = json.loads((VIEWER / "package.json").read_text("utf-8"))


def bundle(name: str) -> str:
    return (files("tactile_hand_ros.report") / name).read_text("utf-8")


def digest() -> str:
    """Return the digest of the source, computed like viewer/build.mjs."""
    found = [path for path in (VIEWER / "src").rglob("*") if path.is_file()]
    names = [*FIXED, *(path.relative_to(VIEWER).as_posix() for path in found)]
    sha = hashlib.sha256()
    for name in sorted(names):
        sha.update(name.encode() + b"\0" + (VIEWER / name).read_bytes() + b"\0")
    return sha.hexdigest()


@pytest.mark.parametrize("name", ["viewer.js", "viewer.css"])
def test_is_built_from_this_source(name):
    stated = re.search(r"source sha256 ([0-9a-f]{64})", bundle(name)[:400])
    assert stated, f"{name} does not say what it was built from"
    assert stated.group(1) == digest(), "run `npm ci && npm run build` in viewer/ and commit"


def test_keeps_the_licences_of_what_it_contains():
    text = bundle("viewer.js")
    for name in ("three", "uplot"):
        assert f"{name} {PACKAGE['dependencies'][name]}" in text
    assert "three.js authors" in text and "Leon Sorokin" in text
    assert text.count("Permission is hereby granted, free of charge") >= 2
