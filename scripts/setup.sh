#!/bin/sh
# Set up a checkout on a fresh Debian: system packages, then uv in .tools/, then everything in .venv/.
# Safe to run again: finished steps are skipped. Nothing outside the checkout changes except Debian's
# own packages and uv's download cache.
#
# Usage: scripts/setup.sh [PACKAGE...]    the names of further Debian packages that are needed
#
# KINECT_VO_PYTHON  use this Python (3.11 to 3.13) instead of Debian's own
set -eu
cd "$(dirname "$0")/.."
. scripts/steps.sh
. scripts/debian.sh

python=${KINECT_VO_PYTHON:-/usr/bin/python3}
packages="ca-certificates $native_packages $*"
[ -n "${KINECT_VO_PYTHON:-}" ] || packages="$packages python3 python3-venv"

install_packages() {
    can_install "apt-get update && apt-get install --no-install-recommends$1"
    step "Reading Debian's package lists" apt_get update
    # shellcheck disable=SC2086  # a list of names
    step "Installing from Debian:$1" apt_get install --yes --no-install-recommends $1
}

check_python() {
    "$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' ||
        fail "$python is not Python 3.11 to 3.13; name one in KINECT_VO_PYTHON"
}

install_uv() {
    "$python" -m venv --clear .tools &&
        .tools/bin/python -m pip install --quiet --disable-pip-version-check \
            --require-hashes --only-binary :all: --requirement scripts/uv.txt &&
        cp scripts/uv.txt .tools/installed.txt
}

sync() {
    UV_PYTHON_DOWNLOADS=never UV_PROJECT_ENVIRONMENT=.venv .tools/bin/uv sync \
        --python "$python" --frozen --all-extras --all-groups --no-group docs
}

# shellcheck disable=SC2086  # a list of names
missing=$(missing_packages $packages)
[ -z "$missing" ] || install_packages "$missing"
check_python
cmp -s scripts/uv.txt .tools/installed.txt ||
    step "Installing uv into .tools/ ($(sed -n 's/^uv==\([0-9.]*\).*/\1/p' scripts/uv.txt))" install_uv
step "Installing the locked Python packages into .venv/" sync
# The kernels go into the environment itself, so that all users share them.
CACHE_DIRECTORY=$PWD/.venv/share/kinect-vo step "Compiling the numeric kernels" .venv/bin/kinect-vo warm-up --first
