"""Write the poses of some seconds to a CSV file, for a spreadsheet or pandas.

Usage: python poses_to_csv.py FILE.csv SECONDS [ENDPOINT]
"""

import csv
import sys
import time
from pathlib import Path

from vo_service import InputError, PoseClient, PoseUnavailable

if len(sys.argv) < 3 or not sys.argv[2].replace(".", "", 1).isdecimal():
    sys.exit(__doc__)
file, seconds = Path(sys.argv[1]), float(sys.argv[2])
endpoint = sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7450"
header = ["stamp_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "state", "epoch", "missed"]

try:
    with PoseClient(connect=endpoint) as client, file.open("w", newline="") as out:
        rows = csv.writer(out)
        rows.writerow(header)
        end_s = time.monotonic() + seconds
        for pose in client.poses(timeout_s=10.0):
            numbers = [*pose.position_m, *pose.quaternion_xyzw]
            rows.writerow([pose.stamp_s, *numbers, pose.state, pose.epoch, pose.missed])
            if time.monotonic() > end_s:
                break
except PoseUnavailable as error:
    sys.exit(f"ten seconds without a pose: {error}")
except (InputError, KeyboardInterrupt, OSError) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
