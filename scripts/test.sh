#!/bin/sh
# Set up what is missing, then check everything: style, types, lock file, tests.
# With arguments: only pytest, with these arguments: scripts/test.sh tests/drivers -k stamps
set -eu
cd "$(dirname "$0")/.."
. scripts/steps.sh

# A compiler, for the stand-in that plays a Kinect on the wire; udev, to try the rules on, and
# systemd's tools, which judge the units. Neither is started.
scripts/setup.sh gcc libc6-dev udev systemd
export PATH="$PWD/.venv/bin:$PATH"
# Tests start hundreds of processes: where no compiled modules may be kept, each takes twice as long.
unset PYTHONDONTWRITEBYTECODE
# Once, or all tests that run at once would compile them at the same time, each for itself.
compile_kernels() {
    for method in keyframe icp surf sfm; do
        kinect-vo warm-up --method "$method" || return
    done
}
if [ $# = 0 ]; then
    say "Compiling the numeric kernels, while all else is checked"
    compile_kernels &
    step "Checking the layout of the code" ruff format --check
    step "Checking the style of the code" ruff check
    step "Checking types" mypy
    step "Checking that the lock file is up to date" .tools/bin/uv lock --check --python .venv/bin/python
    step "Checking that every locked package is a wheel" python scripts/check_lock.py
    step "Waiting for the numeric kernels" wait $!
fi
say "Running the tests"
# More of them at once than there are processors: many wait for a sensor, a viewer or a time-out.
at_once=$(($(nproc) * 2))
[ $# != 0 ] || set -- --numprocesses=$((at_once > 8 ? 8 : at_once)) --dist=worksteal --timeout=600
exec pytest "$@"
