#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Finds the browser that the report's tests drive, or installs it where that can be done without asking.
set -eu

have() {
    for name in "$@"; do
        command -v "$name" >/dev/null 2>&1 && return 0
    done
    return 1
}

ready() {
    have chromium chromium-browser google-chrome google-chrome-stable && have chromedriver
}

ready && exit 0

root=
if [ "$(id -u)" != 0 ] && have sudo && sudo -n true 2>/dev/null; then
    root="sudo -n"
fi
if have apt-get && { [ "$(id -u)" = 0 ] || [ -n "$root" ]; }; then
    echo 'set-up: Chromium, for the tests of the report'
    export DEBIAN_FRONTEND=noninteractive
    $root apt-get update -qq >/dev/null && $root apt-get install -y -qq --no-install-recommends \
        chromium chromium-driver >/dev/null || true
fi
ready && exit 0

echo "The tests of the report need Chromium or Google Chrome and chromedriver on the PATH, and they are not there;" \
    "install them, with 'apt-get install chromium chromium-driver' on Debian." >&2
exit 1
