"""Write one colored point cloud in the axes of odom.

Usage: python save_points.py CLOUD.ply [ENDPOINT]
"""

import sys
from pathlib import Path

import numpy as np

from vo_service import FrameClient, FrameUnavailable, InputError

HEADER = """ply
format binary_little_endian 1.0
element vertex {}
property float x\nproperty float y\nproperty float z
property uchar red\nproperty uchar green\nproperty uchar blue
end_header
"""
if len(sys.argv) < 2:
    sys.exit(__doc__)
try:
    with FrameClient(connect=(*sys.argv[2:], "tcp/127.0.0.1:7450")[0]) as client:
        cloud = next(client.points(timeout_s=10.0))
except (FrameUnavailable, InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
vertices = np.empty(len(cloud.rgb), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
vertices["xyz"], vertices["rgb"] = cloud.xyz_odom_m, cloud.rgb
header = HEADER.format(len(vertices)).encode()
Path(sys.argv[1]).write_bytes(header + vertices.tobytes())
print(f"{len(vertices)} points at {cloud.stamp_s:.3f} s, {cloud.pose.state}")
