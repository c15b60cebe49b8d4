# SPDX-License-Identifier: Apache-2.0
"""What the site adds to Markdown: formulas as MathML, and pages that are generated from the code.

Browsers draw MathML without a script; ``pymdownx.arithmatex`` in generic mode finds the formulas.
A line ``[commands]`` becomes the help of all commands, ``[api]`` the public names, and
``[notebook NAME]`` what that notebook shows when it is executed.
"""

from __future__ import annotations

import html
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown.extensions import Extension
from markdown.postprocessors import Postprocessor
from markdown.preprocessors import Preprocessor

import tactile_hand_ros

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)
_NOTEBOOK = re.compile(r"\[notebook (\S+)\]")
_DOCS = Path(__file__).resolve().parent
_AFTER_RAW_HTML, _BEFORE_FENCES = 10, 29


class _Formulas(Postprocessor):
    def run(self, text: str) -> str:
        return _FORMULA.sub(_mathml, text)


def _mathml(found: re.Match[str]) -> str:
    tag, opening, formula = found.groups()
    mathml = convert(html.unescape(formula), display="block" if opening == "[" else "inline")
    return f'<{tag} class="formula">{mathml}</{tag}>'


class _Generated(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        return [made for line in lines for made in _generated(line)]


def _generated(line: str) -> list[str]:
    if line == "[commands]":
        return _commands()
    if line == "[api]":
        return _api()
    if named := _NOTEBOOK.fullmatch(line):
        [notebook] = _DOCS.rglob(named.group(1))
        return _printed(str(_DOCS / "notebook.py"), str(notebook))
    return [line]


def _printed(*words: str) -> list[str]:
    """Run Python with these arguments and return the lines that it prints."""
    done = subprocess.run([sys.executable, *words], check=True, stdout=subprocess.PIPE, text=True)
    return done.stdout.splitlines()


def _commands() -> list[str]:
    words = ("typer", "tactile_hand_ros.cli.app", "utils", "docs", "--name", "tactile-hand")
    return _printed("-m", *words)[1:]  # the page has its own title


def _api() -> list[str]:
    lines = []
    for name in tactile_hand_ros.__all__:
        found = getattr(tactile_hand_ros, name)
        home = f"{found.__module__}.{name}" if hasattr(found, "__module__") else found.__name__
        lines += [f"::: {home}", ""]
    return lines


class _Site(Extension):
    def extendMarkdown(self, md: Any) -> None:
        md.preprocessors.register(_Generated(md), "generated", _BEFORE_FENCES)
        md.postprocessors.register(_Formulas(md), "mathml", _AFTER_RAW_HTML)


def makeExtension(**options: Any) -> Extension:
    """Return the extension; Markdown calls this."""
    return _Site(**options)
