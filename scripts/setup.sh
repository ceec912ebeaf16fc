#!/bin/sh
# Set up a checkout on a fresh Debian: system packages, then uv in .tools/, then everything in .venv/.
# Safe to run again: what is there already is left alone. Nothing outside the checkout is touched
# except Debian's own packages and uv's download cache.
#
# Usage: scripts/setup.sh [PACKAGE...]    the names of further Debian packages that are needed
#
# KINECT_VO_PYTHON  use this Python (3.11 to 3.13) in place of Debian's own
set -eu
cd "$(dirname "$0")/.."
. scripts/steps.sh

python=${KINECT_VO_PYTHON:-/usr/bin/python3}
# The sensors' native libraries, loaded by name when a sensor is opened.
packages="ca-certificates libfreenect0.5 libopenni2-0 libusb-1.0-0 $*"
[ -n "${KINECT_VO_PYTHON:-}" ] || packages="$packages python3 python3-venv"

missing_packages() {
    command -v dpkg-query >/dev/null || return 0 # not a Debian: take them as given
    for package in $packages; do
        case $(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>&1) in
            installed) ;;
            *) printf ' %s' "$package" ;;
        esac
    done
}

# apt_get ARGUMENTS...: as root or through sudo; asks nothing, prints only what goes wrong.
apt_get() {
    set -- env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 apt-get -qq -o Dpkg::Use-Pty=0 "$@"
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi >/dev/null
}

install_packages() {
    by_hand="as root: apt-get update && apt-get install --no-install-recommends$1"
    [ "$(id -u)" = 0 ] || command -v sudo >/dev/null || fail "neither root nor sudo here; run once $by_hand"
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
        --python "$python" --frozen --all-extras --all-groups
}

missing=$(missing_packages)
[ -z "$missing" ] || install_packages "$missing"
check_python
cmp -s scripts/uv.txt .tools/installed.txt ||
    step "Installing uv into .tools/ ($(sed -n 's/^uv==\([0-9.]*\).*/\1/p' scripts/uv.txt))" install_uv
step "Installing the locked Python packages into .venv/" sync
