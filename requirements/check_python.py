# SPDX-License-Identifier: Apache-2.0
"""Say in one sentence why the set-up cannot work here. Runs on any Python, so no new syntax."""

import platform
import sys


def problem():
    """Return what stands in the way, or an empty string."""
    found = "%s is Python %s" % (sys.executable, platform.python_version())
    if sys.version_info < (3, 10):
        return found + ", 3.10 or newer is needed: make ... PYTHON=python3.12"
    if sys.version_info >= (3, 15):
        return found + ", the ROS wheels stop at 3.14: make ... PYTHON=python3.12"
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        return "the ROS wheels need x86-64 Linux, this is %s %s: use ROS 2 Jazzy and colcon" % (
            sys.platform,
            platform.machine(),
        )
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError as error:
        return "%s without the module %s, which makes virtual environments: %s" % (
            found,
            error.name,
            "install it (Debian, Ubuntu: apt install python3-venv)",
        )
    return ""


if __name__ == "__main__":
    text = problem()
    if text:
        sys.exit("set-up: " + text)
