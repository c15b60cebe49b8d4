# SPDX-License-Identifier: Apache-2.0
"""A run and its page: template, style, script and document in one HTML file."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.files import replace_text
from tactile_hand_ros.report.document import MAX_BYTES, run_document
from tactile_hand_ros.report.figures import motion_figure
from tactile_hand_ros.report.style import AXES
from tactile_hand_ros.run.metrics import json_ready
from tactile_hand_ros.run.result import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT = "report.html"

MOST_EARLIER = 9
"""Maximum number of sections before the last one."""

_PLACE = re.compile(r"@@(\w+)@@")


def write_report(run: RunData, folder: Path | None = None) -> Path:
    """Write ``report.html`` of a run and return the file; each reset starts a new section.

    By default, `folder` is the run's folder, or that of a bare bag.

    Raises:
        BagError: If the bag is damaged or has no tick.
        TactileHandError: If the file cannot be written.
    """
    sections = [*run.earlier[-MOST_EARLIER:], run]
    room = MAX_BYTES // len(sections)
    documents = [run_document(section, room=room) for section in sections]
    file = (folder or run.folder) / REPORT
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_text(file, _filled(run.name, {"runs": documents}, "'none'"))
    except OSError as error:
        raise TactileHandError(
            f"The report {file} cannot be written ({error.strerror}); choose another place."
        ) from None
    return file


def live_page(name: str) -> str:
    """Return the page for a running hand: it connects to the WebSocket ``socket``."""
    return _filled(name, {"live": name}, "'self'")


def _filled(name: str, content: dict[str, Any], connections: str) -> str:
    style, script = _resource("viewer.css"), _resource("viewer.js")
    parts = {
        "title": html.escape(f"{name} - tactile hand"),
        "style": style,
        "style_hash": _source_hash(style),
        "script": script,
        "script_hash": _source_hash(script),
        "connections": connections,
        "document": _json({"axes": AXES, **content}),
    }
    return _PLACE.sub(lambda place: parts[place.group(1)], _resource("template.html"))


def _resource(name: str) -> str:
    return (files(__package__ or "") / name).read_text(encoding="utf-8")


def _source_hash(text: str) -> str:
    """Return the hash by which a content security policy permits an inline text.

    Source: W3C, Content Security Policy Level 3, section 2.3.1 (hash-source).
    """
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


def _json(document: dict[str, Any]) -> str:
    """Return JSON that cannot close its script element."""
    text = json.dumps(json_ready(document), allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


class Result(RunData):
    """A run: `record`, `metrics`, `events`, `assumptions`, `to_pandas()`, `plot()`, `report()`."""

    def plot(self) -> Figure:
        """Return the paper's Fig. 3 of this run: rates, position, orientation error, forces."""
        return motion_figure(self.record, self._hand[0])

    def report(self, folder: Path | str | None = None) -> Path:
        """Write ``report.html`` and return the file; see `write_report`.

        By default, `folder` is the run's folder, or the current one without a bag.
        """
        return write_report(self, None if folder is None else Path(folder))
