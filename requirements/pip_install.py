# SPDX-License-Identifier: Apache-2.0
"""Install with pip and show one line for each package: the set-up takes minutes.

Whatever pip says is kept, and shown when it fails.
"""

import re
import subprocess
import sys

_STEPS = (
    (
        re.compile(r"\s*Downloading (?:\S*/)?([^-/\s]+)-\S+ \(([\d.]+ [MG]B)\)"),
        "  downloads {} ({})",
    ),
    (
        re.compile(r"\s*Using cached ([^-/\s]+)-\S+ \(([\d.]+ [MG]B)\)"),
        "  takes {} ({}) from the cache",
    ),
    (re.compile(r"Building wheels? for collected packages: (.*)"), "  builds {}"),
    (re.compile(r"Installing collected packages: (.*)"), "  unpacks {} packages"),
)
_SHOWN_AFTER_FAILURE = 30  # lines


def progress(line):
    """Return what to show of a line of pip, empty if nothing."""
    for pattern, text in _STEPS:
        found = pattern.match(line)
        if found is None:
            continue
        if "unpacks" in text:
            return text.format(len(found.group(1).split(", ")))
        return text.format(*found.groups())
    return ""


def main(arguments):
    """Run pip with these arguments and return its exit code."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "install"]
    command += ["--progress-bar", "off", *arguments]
    said = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as pip:
        for line in pip.stdout:
            said.append(line)
            if text := progress(line):
                print(text, flush=True)
    if pip.returncode:
        print("".join(said[-_SHOWN_AFTER_FAILURE:]), end="", file=sys.stderr)
    return pip.returncode


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        print("set-up: interrupted", file=sys.stderr)
        sys.exit(130)
