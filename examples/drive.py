"""A control loop: ten times a second the newest pose, or a stop if there is no reliable one.

Usage: python drive.py [ENDPOINT]
"""

import signal
import sys
import time

import numpy as np

from vo_service import InputError, PoseClient, PoseUnavailable

PERIOD_S = 0.1
GOAL_M = np.array([1.0, 0.0])

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end without an error in `| head`
endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

try:
    with PoseClient(connect=endpoint) as client:
        start_m = np.zeros(2)
        while True:
            try:
                pose = client.newest(max_age_s=0.2)
            except PoseUnavailable as error:
                print(f"stop: {error}", flush=True)
            else:
                if not pose.is_continuous:
                    # The pose jumped (a reset, a restart, a loss): plans in odom are invalid.
                    start_m = pose.position_m[:2]
                remaining_m = start_m + GOAL_M - pose.position_m[:2]
                print(f"drive: {np.linalg.norm(remaining_m):.2f} m to go", flush=True)
            time.sleep(PERIOD_S)
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
