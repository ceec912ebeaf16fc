#!/bin/sh
# Check that kinect-vo installs and runs without a network: in an isolated network namespace, from a folder of wheels
# into fresh virtual environments, with and without Rerun. It takes a few minutes. It needs root, or a kernel that
# lets users create namespaces, and Debian's iproute2 and util-linux.
#
# Usage: scripts/test_offline.sh [FOLDER]    a folder that scripts/wheels.sh made (default: make one)
set -eu
checkout=$(cd "$(dirname "$0")/.." && pwd)
. "$checkout/scripts/steps.sh"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
if [ $# = 0 ]; then
    "$checkout/scripts/wheels.sh" "$work/wheels"
    set -- "$work/wheels"
fi
wheels=$(cd "$1" && pwd)
cd "$work"

case $(id -u) in 0) cut_off="unshare --net" ;; *) cut_off="unshare --net --map-root-user" ;; esac
# offline COMMAND...: run it with the loopback interface only.
offline() {
    # shellcheck disable=SC2016  # $@ is the inner shell's
    $cut_off sh -euc 'ip link set lo up; test "$(ip -o link | wc -l)" = 1; exec "$@"' offline "$@"
}

# use VENV: run the commands of a new user.
use() {
    export XDG_CACHE_HOME="$work/cache" PATH="$work/$1/bin:/usr/bin:/bin:/usr/sbin:/sbin"
    offline kinect-vo --help >/dev/null &&
        offline kinect-vo demo --help >/dev/null &&
        offline kinect-vo record --camera synthetic --seconds 2 "$work/$1-room" &&
        offline kinect-vo replay "$work/$1-room" --trajectory "$work/$1.txt" &&
        offline sh -euc 'kinect-vo run --camera synthetic & kinect-vo listen --count 60 >poses.txt; kill -TERM $!; wait $!' &&
        test "$(wc -l <poses.txt)" = 60 &&
        offline kinect-vo demo --seconds 2 --output "$work/$1-demo"
}

step "Installing without a network" offline "$wheels/install.sh" "$work/all"
step "Running the installation" use all
step "Installing again, over it" offline "$wheels/install.sh" "$work/all"
step "Installing without Rerun" offline "$wheels/install.sh" --without-rerun "$work/small"
step "Checking that it has no Rerun" sh -c "! '$work/small/bin/python' -c 'import rerun' 2>/dev/null"
step "Running the installation without Rerun" use small
step "Comparing the trajectories of one recording" offline "$work/small/bin/kinect-vo" replay "$work/all-room" --trajectory again.txt
cmp again.txt all.txt || fail "the trajectories differ"
say "kinect-vo installs and runs without a network"
