#!/bin/sh
# Run the setup if needed, then the odometry on the virtual Kinect.
# Arguments go to `kinect-vo demo`: scripts/demo.sh --help
set -eu
checkout=$(cd "$(dirname "$0")/.." && pwd)
"$checkout/scripts/setup.sh"
"$checkout/.venv/bin/kinect-vo" demo "$@"
echo "next, with a Kinect: .venv/bin/kinect-vo doctor, then .venv/bin/kinect-vo run --camera freenect" >&2
