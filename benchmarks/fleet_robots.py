"""Several robots of a fleet in one process: the service's publishers, 30 poses per second each.

    python -m benchmarks fleet_robots SECONDS ZENOH_FILE...

A robot's name and prefix is the folder of its file. The process prints "ready" once the router and
the reader are connected, publishes after "go" on standard input, then prints "ready" again.
"""

import sys
import time
from pathlib import Path

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.output import LIVE_QOS, ZenohOutput
from vo_service.types import Estimate, OdometryUpdate, TrackingState

POSES_PER_SECOND = 30
CONNECT_TIMEOUT_S = 30.0
DRAIN_S = 1.0
_CAMERA = PinholeCamera(2, 2, 1.0, 1.0, 0.5, 0.5)
_I = np.eye(4)
_FRAME = RgbdFrame(
    0, 0.0, 0.0, np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.uint16), 1e3, _CAMERA
)
_ESTIMATE = Estimate(True, "", _I, _I, np.eye(6), 500, 200, 150)


def main(seconds: int, files: list[Path]) -> None:
    """Publish poses; see the module."""
    robots = [
        ZenohOutput(ZenohConfig(prefix=file.parent.name, config_file=file, listen=()), LIVE_QOS)
        for file in files
    ]
    if not all(robot.wait_for_subscriber(CONNECT_TIMEOUT_S) for robot in robots):
        raise SystemExit("no reader")
    print("ready", flush=True)
    sys.stdin.readline()
    begin_s = time.monotonic()
    for turn in range(seconds * POSES_PER_SECOND * len(robots)):
        # The robots publish one after another, evenly over the thirtieth of a second.
        due_s = begin_s + turn / (POSES_PER_SECOND * len(robots))
        time.sleep(max(0.0, due_s - time.monotonic()))
        robots[turn % len(robots)].on_update(_make_update(turn // len(robots), time.monotonic()))
    time.sleep(DRAIN_S)
    print("ready", flush=True)
    for robot in robots:
        robot.close()


def _make_update(seq: int, stamp_s: float) -> OdometryUpdate:
    """Make a pose with a stamp on CLOCK_MONOTONIC, which the reader compares."""
    return OdometryUpdate(
        seq=seq,
        stamp_s=stamp_s,
        state=TrackingState.TRACKING,
        reason="",
        epoch=1,
        T_world_camera=_I,
        T_odom_base=_I,
        T_odom_camera=_I,
        pose_covariance=np.eye(6),
        twist=np.zeros(6),
        twist_covariance=np.eye(6),
        frame=_FRAME,
        estimate=_ESTIMATE,
        stage_ms={},
        latency_s=0.0,
    )


if __name__ == "__main__":
    main(int(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
