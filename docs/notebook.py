# SPDX-License-Identifier: Apache-2.0
"""Execute a Jupyter notebook and print it as Markdown, with its output and figures.

Jupyter's own executor (nbclient and ipykernel) would add thirty packages to those of the site. This
one runs plain Python: the text that a cell prints, the value of its last line, and figures.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")

from matplotlib import pyplot
from matplotlib.figure import Figure


def markdown(notebook: Path) -> Iterator[str]:
    """Yield the cells of a notebook as Markdown, each code cell with what it gives."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            yield source
            continue
        yield f"```python\n{source}\n```"
        text, figures = executed(source, names)
        if text:
            yield f"```text\n{text}```"
        yield from map(image, figures)


def executed(source: str, names: dict[str, Any]) -> tuple[str, list[Figure]]:
    """Run a cell as Jupyter does: the value of a last expression without a semicolon is shown.

    Args:
        source: The code.
        names: Variables of the cells before; changed.

    Returns:
        What was printed, and the figures.
    """
    code = ast.parse(source)
    shown = isinstance(code.body[-1], ast.Expr) and not source.endswith(";")
    last = ast.Expression(code.body.pop().value) if shown else ast.parse("None", mode="eval")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "<cell>", "exec"), names)
        value = eval(compile(last, "<cell>", "eval"), names)
        if value is not None and not isinstance(value, Figure):
            print(repr(value))
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    if isinstance(value, Figure) and value not in figures:
        figures.append(value)
    pyplot.close("all")
    return printed.getvalue(), figures


def image(figure: Figure) -> str:
    """Return a figure as an image inside the page."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    text = base64.b64encode(data.getvalue()).decode()
    return f'<p><img alt="figure" src="data:image/png;base64,{text}"></p>'


if __name__ == "__main__":
    print("\n\n".join(markdown(Path(sys.argv[1]))))
