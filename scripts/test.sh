#!/bin/sh
# Run the setup if needed, then check everything: style, types, lock file, tests.
#
# Usage: scripts/test.sh                       everything
#        scripts/test.sh --fast [ARGUMENT...]  only style, types and the quick tests
#        scripts/test.sh ARGUMENT...           only pytest, with these arguments:
#                                              scripts/test.sh tests/drivers -k stamps
set -eu
cd "$(dirname "$0")/.."
. scripts/steps.sh

# A compiler for the Kinect simulator and, with Python's headers, for a package of ROS 2; udev's and systemd's tools
# to check the rules and the units; ROS 1's rosbag to read our bags.
# No service is started.
scripts/setup.sh gcc libc6-dev g++ libpython3-dev udev systemd python3-rosbag
export PATH="$PWD/.venv/bin:$PATH"
# Tests start hundreds of processes: without cached bytecode each takes twice as long.
unset PYTHONDONTWRITEBYTECODE
# Compile once, so that the pytest processes do not all compile the same: the kernels that the setup
# omits, and in a fresh checkout the tests' own modules.
compile_all() {
    python -c '
import os

from drivers.core.folders import kernel_folder

os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())  # before numba is imported

from vo_service.kernels.compilation import ensure_compiled
from vo_service.kernels.kernel_list import read_kernel_list

ensure_compiled([each.part for each in read_kernel_list()], lambda progress: None)
' || return
    [ -d tests/__pycache__ ] || pytest --collect-only --quiet >/dev/null
}
# It prints a page also where all is well.
check_imports() {
    found=$(PYTHONPATH=ros2 lint-imports --no-cache 2>&1) || {
        say "$found"
        return 1
    }
}
check_code() {
    step "Checking the layout of the code" ruff format --check
    step "Checking the style of the code" ruff check
    step "Checking types" mypy
    step "Checking the direction of imports" check_imports
}
# More processes than processors: many tests wait for a sensor, a viewer or a timeout.
processes=$(($(nproc) * 2))
case ${1:-} in
--fast)
    shift
    check_code
    # pyproject.toml describes the markers. Quick tests do not wait: one process per processor.
    set -- -m "not (slow or subprocess or zenoh or rerun or hardware_simulator)" \
        --numprocesses="$(nproc)" --durations=5 "$@"
    ;;
"")
    say "Compiling the other numeric kernels and the tests in the background"
    compile_all &
    scripts/setup_ros2.sh
    check_code
    step "Checking that the lock file is up to date" .tools/bin/uv lock --check --python .venv/bin/python
    step "Checking that every locked package is a wheel" python scripts/check_lock.py
    step "Waiting for the compilation" wait $!
    set -- --numprocesses=$((processes > 8 ? 8 : processes)) --dist=worksteal --timeout=600
    ;;
esac
say "Running the tests"
exec pytest "$@"
