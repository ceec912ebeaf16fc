"""Print every new pose.

Usage: python print_poses.py [ENDPOINT]
"""

import signal
import sys

from vo_service import InputError, PoseClient

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end without an error in `| head`
endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

try:
    with PoseClient(connect=endpoint) as client:
        for pose in client.poses():
            print(pose.stamp_s, pose.position_m, pose.state, flush=True)
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
