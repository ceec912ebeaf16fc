"""Print the robot's pose in the map: every new pose, corrected by the map -> odom transform.

Usage: python pose_in_map.py [ENDPOINT]
"""

import signal
import sys

from vo_service import CommandRefused, InputError, PoseClient, ServiceUnavailable

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end without an error in `| head`
endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

try:
    with PoseClient(connect=endpoint) as client:
        for pose in client.poses():
            odom = client.map_odom()
            if odom.is_localized and odom.epoch == pose.epoch:
                T_map_base = odom.T_map_odom @ pose.T_odom_base
                print(pose.stamp_s, T_map_base[:3, 3], pose.state, flush=True)
except (CommandRefused, InputError, KeyboardInterrupt, ServiceUnavailable) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
