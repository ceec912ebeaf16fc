"""Estimate the motion of a camera and print its position at every frame.

Usage: python odometry.py [SOURCE] [METHOD]

SOURCE is "synthetic" (the default: a virtual Kinect), "freenect", "tum:FOLDER" and others; METHOD
is "direct" (the default), "surf", "icp" or "sfm".
"""

import os
import sys

from drivers import CameraError, InputError, open_camera
from vo_service import make_odometry

source = sys.argv[1] if len(sys.argv) > 1 else "synthetic"
method = sys.argv[2] if len(sys.argv) > 2 else "direct"

try:
    odometry = make_odometry(method)
    with open_camera(source) as camera:
        for frame in camera:
            estimate = odometry.estimate(frame)
            position_m = estimate.T_world_camera[:3, 3]
            state = "ok" if estimate.ok else f"lost: {estimate.reason}"
            print(f"{frame.stamp_s:.3f} {position_m.round(3)} {state}", flush=True)
except (CameraError, InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
except BrokenPipeError:  # in `| head`
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
