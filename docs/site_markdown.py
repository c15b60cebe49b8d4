# SPDX-License-Identifier: Apache-2.0
"""What the site adds to Markdown: formulas as MathML, and pages that are generated from the code.

Browsers draw MathML without a script; ``pymdownx.arithmatex`` in generic mode finds the formulas.
A line ``[commands]`` becomes the help of all commands, a line ``[api]`` the public names.
"""

from __future__ import annotations

import html
import re
import subprocess
import sys
from typing import Any

from latex2mathml.converter import convert
from markdown.extensions import Extension
from markdown.postprocessors import Postprocessor
from markdown.preprocessors import Preprocessor

import tactile_hand_ros

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)
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
        generators = {"[commands]": _commands, "[api]": _api}
        found = [generators[line]() if line in generators else [line] for line in lines]
        return [line for part in found for line in part]


def _commands() -> list[str]:
    command = [sys.executable, "-m", "typer", "tactile_hand_ros.cli.app", "utils", "docs"]
    text = subprocess.run(
        [*command, "--name", "tactile-hand"], check=True, capture_output=True, text=True
    ).stdout
    return text.splitlines()[1:]  # the page has its own title


def _api() -> list[str]:
    lines = []
    for name in tactile_hand_ros.__all__:
        found = getattr(tactile_hand_ros, name)
        home = f"{found.__module__}.{name}" if hasattr(found, "__module__") else found.__name__
        lines += [f"::: {home}", ""]
    return lines


class _Site(Extension):
    def extendMarkdown(self, md: Any) -> None:  # noqa: N802
        md.preprocessors.register(_Generated(md), "generated", _BEFORE_FENCES)
        md.postprocessors.register(_Formulas(md), "mathml", _AFTER_RAW_HTML)


def makeExtension(**options: Any) -> Extension:  # noqa: N802
    """Return the extension; Markdown calls this."""
    return _Site(**options)
