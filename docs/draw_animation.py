# SPDX-License-Identifier: Apache-2.0
"""Write docs/figures/human_pull.webp: the same pull with slip prevention on and off.

The frames are screenshots of the 3D views in the reports of both runs, taken in Chromium.
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tactile_hand_ros import simulate
from tactile_hand_ros.simulation.plant_config import external_wrench

DOCS = Path(__file__).resolve().parent
FILE = DOCS / "figures" / "human_pull.webp"
START, END = 1.6, 6.4  # s, simulated
RATE = 12  # frames per second, at the speed of the simulation
SIZE = (470, 900)  # of the window; a view takes its width
QUALITY = 55  # of WebP, 0 to 100

_PREPARE = """
Object.assign(report.scene.visible, {frames: false, goal: false, trail: false});
document.querySelectorAll(".tools, .scale, .news").forEach((e) => e.remove());
Object.assign(document.querySelector(".stage").style, {height: "450px", minHeight: 0});
document.querySelector(".hud .time").style.fontSize = "15px";
"""
_SHOW = """
const [time, caption] = arguments;
report.player.seek(time);
document.querySelector(".hud .time").textContent = caption;
"""


def animate() -> None:
    """Run both scenarios, take the frames and write the file."""
    sys.path.insert(0, str(DOCS.parent / "test"))
    from support.browser import browser

    runs = {
        "Slip prevention on": simulate("human_pull"),
        "Slip prevention off": simulate("human_pull", {"slip_regulator.mode": "user"}),
    }
    with tempfile.TemporaryDirectory() as name, browser(Path(name) / "profile") as page:
        halves = [views(page, title, run, Path(name)) for title, run in runs.items()]
    frames = [Image.fromarray(np.hstack(pair)) for pair in zip(*halves, strict=True)]
    duration = [round(1000 / RATE)] * (len(frames) - 1) + [2000]  # ms
    frames[0].save(
        FILE, save_all=True, append_images=frames[1:], duration=duration, loop=0, quality=QUALITY
    )


def views(page: Any, title: str, run: Any, folder: Path) -> list[Any]:
    """Return the pictures of a run, each of shape (height, width, 3)."""
    page.open(run.report(folder), size=SIZE)
    page.js(_PREPARE)
    view = page.driver.find_element("css selector", ".viewport")
    found = []
    for time in np.arange(START, END, 1.0 / RATE):
        page.js(_SHOW, float(time), caption(title, run, time))
        found.append(np.array(Image.open(io.BytesIO(view.screenshot_as_png)).convert("RGB")))
    return found


def caption(title: str, result: Any, time: float) -> str:
    """Return what stands above a view: what pulls, and how firmly the hand holds."""
    pull = np.linalg.norm(external_wrench(result.scenario.plant.disturbances, time)[:3])
    row = int(np.searchsorted(result.record.times, time))
    return f"{title}: pull {pull:.1f} N, grasp force {result.record.grasp_force[row]:.0f} N"


if __name__ == "__main__":
    animate()
