"""Print every frame of a camera or a recording.

Usage: python read_camera.py [SOURCE]

SOURCE is "synthetic" (the default: a virtual Kinect), "freenect", "tum:FOLDER" and others.
"""

import os
import sys

from drivers import CameraError, InputError, open_camera

source = sys.argv[1] if len(sys.argv) > 1 else "synthetic"

try:
    with open_camera(source) as camera:
        for frame in camera:
            height, width, _ = frame.color_bgr.shape
            center_m = frame.depth_m[height // 2, width // 2]  # 0 = no reading
            print(f"{frame.stamp_s:.3f} s: {width}x{height}, {center_m:.2f} m ahead", flush=True)
except (CameraError, InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
except BrokenPipeError:  # in `| head`
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
