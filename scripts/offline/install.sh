#!/bin/sh
# Install kinect-vo from the folder of this script, without a network. Safe to run again: an existing installation
# is replaced when the new one is complete, and restored after a failure.
#
# Usage: install.sh [--without-rerun] [FOLDER]    into FOLDER (default: /opt/kinect-vo)
#
# KINECT_VO_PYTHON  use this Python instead of Debian's own
set -eu
umask 022 # all users, such as that of the service, must be able to read it
here=$(cd "$(dirname "$0")" && pwd)
. "$here/steps.sh"
. "$here/debian.sh"
. "$here/made_for.sh"

refuse() {
    printf '%s: %s\n' "${0##*/}" "$*" >&2
    exit 2
}

usage="usage: install.sh [--without-rerun] [FOLDER]"
requirements=requirements-rerun.txt target=
while [ $# != 0 ]; do
    case $1 in
        --without-rerun) requirements=requirements.txt ;;
        -*) refuse "$1 is unknown; $usage" ;;
        *) [ -z "$target" ] || refuse "two folders: $target and $1; $usage" && target=$1 ;;
    esac
    shift
done
[ -f "$here/$requirements" ] || requirements=requirements.txt # made without Rerun
python=${KINECT_VO_PYTHON:-/usr/bin/python3}
[ "$(uname -m)" = "$machine" ] ||
    refuse "this folder is for $machine and this computer is $(uname -m); make one with wheels.sh --machine $(uname -m)"
target=${target:-/opt/kinect-vo}
parent=$(cd "$(dirname "$target")" 2>/dev/null && pwd) && [ -w "$parent" ] ||
    refuse "$target: you may not write to $(dirname "$target"), or it is no folder; use sudo, or name another"
target=$parent/$(basename "$target")
before=$target.before beside=$target.unpacking
# After an interrupted run, restore the installation before it.
rm -rf "$beside"
if [ -e "$before" ]; then rm -rf "$target" && mv "$before" "$target"; fi
if [ -e "$target" ] && [ ! -x "$target/bin/kinect-vo" ] && ! rmdir "$target" 2>/dev/null; then
    refuse "$target is there already and not a kinect-vo: name another folder"
fi

check_sums() {
    (cd "$here" && sha256sum --check --quiet --strict SHA256SUMS)
}

packages=$native_packages
[ -n "${KINECT_VO_PYTHON:-}" ] || packages="$packages python3"

# From the folder's own archive; installed packages stay, unless another package needs a newer version.
install_packages() {
    apt=$(mktemp -d) && mkdir -p "$apt/lists/partial" && ln -s "$here/debian" "$apt/archive"
    echo "deb [trusted=yes] file:$apt/archive ./" >"$apt/sources"
    options="-o Dir::Etc::SourceList=$apt/sources -o Dir::Etc::SourceParts=/dev/null"
    options="$options -o Dir::State::Lists=$apt/lists -o APT::Sandbox::User=root"
    # shellcheck disable=SC2086  # a list of options
    apt_get $options update && apt_get $options install --yes --no-install-recommends "$@" && installed=yes || installed=no
    rm -rf "$apt"
    [ "$installed" = yes ]
}

check_python() {
    "$python" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$python_version')" ||
        fail "$python is not Python $python_version, for which this folder was made; name one in KINECT_VO_PYTHON, or make" \
            "a folder with wheels.sh --python"
}

# With uv from its wheel. It unpacks beside the target, on the same disk, so that files need not be copied.
install() {
    mkdir "$beside" && "$python" -m zipfile --extract "$here"/wheels/uv-*.whl "$beside/uv" || return 1
    uv=$(echo "$beside"/uv/uv-*.data/scripts/uv) && chmod +x "$uv" || return 1
    export UV_CACHE_DIR="$beside/cache" UV_OFFLINE=1 UV_PYTHON_DOWNLOADS=never UV_NO_CONFIG=1 UV_NO_PROGRESS=1
    "$uv" venv --quiet --python "$python" "$target" &&
        "$uv" pip install --quiet --python "$target" --no-index --find-links "$here/wheels" --require-hashes \
            --only-binary :all: --compile-bytecode --requirement "$here/$requirements"
}

put_back() {
    rm -rf "$target" "$beside"
    [ ! -e "$before" ] || mv "$before" "$target"
}

step "Checking that this folder is complete" check_sums
# shellcheck disable=SC2086  # a list of names
missing=$(missing_packages $packages)
if [ -n "$missing" ]; then
    [ "$(. /etc/os-release && echo "${VERSION_CODENAME:-}")" = "${debian_release:-none}" ] ||
        fail "this folder has no packages for this Debian; install once by hand:$missing"
    can_install "$0"
    # shellcheck disable=SC2086  # a list of names
    step "Installing from the folder:$missing" install_packages $missing
fi
check_python
[ ! -e "$target" ] || mv "$target" "$before"
trap put_back EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
step "Installing kinect-vo into $target" install
installed=$("$target/bin/kinect-vo" --version) || fail "the installed kinect-vo does not start"
# The kernels go into the environment itself, so that all users share them.
CACHE_DIRECTORY=$target/share/kinect-vo step "Compiling the numeric kernels" "$target/bin/kinect-vo" warm-up
trap - EXIT
[ ! -e "$before" ] || mv "$before" "$beside/before" # the new installation works: do not restore the old one
rm -rf "$beside"
say "$installed is installed: $target/bin/kinect-vo doctor looks at the sensor, service install makes it a service"
