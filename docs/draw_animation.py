# SPDX-License-Identifier: Apache-2.0
"""Write docs/figures/human_pull.webp: the same pull with slip prevention on and off.

The frames are screenshots of the 3D views in a comparison page, taken in Chromium.
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
from tactile_hand_ros.report.page import write_comparison
from tactile_hand_ros.simulation.plant_config import external_wrench

DOCS = Path(__file__).resolve().parent
FILE = DOCS / "figures" / "human_pull.webp"
START, END = 1.6, 6.4  # s, simulated
RATE = 12  # frames per second, at the speed of the simulation
SIZE = (880, 900)  # of the window; the views take its width
QUALITY = 55  # of WebP, 0 to 100

_PREPARE = """
for (const scene of report.scenes)
    Object.assign(scene.visible, {frames: false, goal: false, trail: false});
"""
_SHOW = """
const [time, captions] = arguments;
report.player.seek(time);
document.querySelectorAll(".beside .name").forEach((e, i) => { e.textContent = captions[i]; });
"""


def animate() -> None:
    """Run both scenarios, take the frames and write the file."""
    sys.path.insert(0, str(DOCS.parent / "test"))
    from support.browser import browser

    runs = {
        "Slip prevention on": simulate("human_pull"),
        "Slip prevention off": simulate("human_pull", {"slip_regulator.mode": "user"}),
    }
    frames = []
    with tempfile.TemporaryDirectory() as name, browser(Path(name) / "profile") as page:
        page.open(write_comparison([*runs.values()], Path(name) / "comparison.html"), size=SIZE)
        page.js(_PREPARE)
        views = page.driver.find_element("css selector", ".beside-all")
        for time in np.arange(START, END, 1.0 / RATE):
            page.js(_SHOW, float(time), [caption(*run, time) for run in runs.items()])
            frames.append(Image.open(io.BytesIO(views.screenshot_as_png)).convert("RGB"))
    duration = [round(1000 / RATE)] * (len(frames) - 1) + [2000]  # ms
    frames[0].save(
        FILE, save_all=True, append_images=frames[1:], duration=duration, loop=0, quality=QUALITY
    )


def caption(title: str, result: Any, time: float) -> str:
    """Return what stands above a view: what pulls, and how firmly the hand holds."""
    pull = np.linalg.norm(external_wrench(result.scenario.plant.disturbances, time)[:3])
    row = int(np.searchsorted(result.record.times, time))
    return f"{title}: pull {pull:.1f} N, grasp force {result.record.grasp_force[row]:.0f} N"


if __name__ == "__main__":
    animate()
