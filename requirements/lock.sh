#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Write requirements/locked: every package that pip installs, with the hashes of its files, for each Python that is
# supported. `make lock` runs it after a pin has changed. A file lists only what the files before it do not have.
set -eu
cd "$(dirname "$0")"
uv=${UV:-uv}
index=${INDEX:-https://pypi.org/simple}

# Packages of a locked file for every Python; one with a marker may be needed again.
names() { sed -n 's/^\([A-Za-z0-9._-]*\)==[^;]*$/\1/p' "$@" | sort -u; }

# lock NAME BASE...: what requirements/NAME.txt needs on top of the locked files BASE.
lock() {
    name=$1
    shift
    known=$(for base in "$@"; do names "locked/$base.txt" | sed 's/^/--no-emit-package=/'; done)
    constraints=$(for base in "$@"; do echo "--constraint=locked/$base.txt"; done)
    inputs=$(for base in "$@"; do echo "$base.txt"; done)
    # shellcheck disable=SC2086
    "$uv" pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-annotate \
        --default-index "$index" --custom-compile-command 'make lock' \
        $known $constraints ros.txt $inputs "$name.txt" --output-file "locked/$name.txt"
}

mkdir -p locked
rm -f locked/*.txt
lock run
lock studies run
lock dev run
lock docs run
# Only files of these packages are read, so what they require is left out.
"$uv" pip compile --quiet --universal --python-version 3.10 --generate-hashes --no-annotate --no-deps \
    --default-index "$index" --custom-compile-command 'make lock' hands.txt --output-file locked/hands.txt
