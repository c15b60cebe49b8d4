# SPDX-License-Identifier: Apache-2.0
"""A headless browser, and the errors and requests of a page."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DEADLINE = 60.0
"""Longest wait for a condition, s; software rendering on a busy machine is slow."""

_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    # By default, the browser contacts its vendor's servers.
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)

# Plots take their width after the layout of the page.
_FITTED = """return report.charts.every(
    ({plot, body}) => Math.abs(plot.width - body.clientWidth) <= 1)"""


def _find(names: tuple[str, ...]) -> str:
    found = next((path for name in names if (path := shutil.which(name))), None)
    assert found, f"none of {', '.join(names)} is installed; run `sh requirements/browser.sh`"
    return found


@contextmanager
def browser(profile: Path, *flags: str) -> Iterator[Page]:
    """Start a browser with a new profile."""
    options = webdriver.ChromeOptions()
    options.binary_location = _find(BROWSERS)
    for flag in (*_FLAGS, *flags, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(_find(("chromedriver",))))
    try:
        yield Page(driver)
    finally:
        driver.quit()


class Page:
    """A browser that shows one of our pages, with ``window.report``."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        self._requests: list[str] = []
        self._errors: list[str] = []

    def open(
        self, place: Path | str, *, dark: bool = False, size: tuple[int, int] = (1000, 700)
    ) -> None:
        """Open a file or an address and wait until it is drawn; clear the logs."""
        for name in ("browser", "performance"):
            self.driver.get_log(name)
        self._requests, self._errors = [], []
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        self._shape(size)
        self.driver.get(place if isinstance(place, str) else place.resolve().as_uri())
        self.wait(lambda: self.js("return Boolean(window.report?.charts.length)"))
        self.wait(lambda: self.js(_FITTED))

    def resize(self, size: tuple[int, int]) -> None:
        """Resize the window and wait until the plots have adapted."""
        self._shape(size)
        self.wait(lambda: self.js("return innerWidth") == size[0] and self.js(_FITTED))

    def _shape(self, size: tuple[int, int]) -> None:
        shape = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", shape)

    def js(self, code: str, *arguments: Any) -> Any:
        """Run JavaScript in the page."""
        return self.driver.execute_script(code, *arguments)

    def wait(self, condition: Callable[[], Any]) -> Any:
        """Wait until a condition holds and return its value; raise TimeoutException if too late."""
        return WebDriverWait(self.driver, DEADLINE, 0.05).until(lambda _: condition())

    @property
    def errors(self) -> list[str]:
        """Errors on the console since the page was opened."""
        logged = self.driver.get_log("browser")
        self._errors += [entry["message"] for entry in logged if entry["level"] == "SEVERE"]
        return self._errors

    @property
    def requests(self) -> list[str]:
        """Addresses that the page has requested since it was opened."""
        for entry in self.driver.get_log("performance"):
            event = json.loads(entry["message"])["message"]
            if event["method"] == "Network.requestWillBeSent":
                self._requests.append(event["params"]["request"]["url"])
        return self._requests
