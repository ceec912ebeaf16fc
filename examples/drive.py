"""A control loop: ten times a second the newest pose, or a stop if there is none to rely on.

Usage: python drive.py [ENDPOINT]
"""

import sys
import time

import numpy as np

from vo_service.client import PoseClient, PoseUnavailable

PERIOD_S = 0.1
GOAL_M = np.array([1.0, 0.0])

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

with PoseClient(connect=endpoint) as client:
    start_m = np.zeros(2)
    while True:
        try:
            pose = client.newest(max_age_s=0.2)
        except PoseUnavailable as none:
            print(f"stop: {none}", flush=True)
        else:
            if not pose.is_continuous:
                # It jumped (a reset, a restart, a loss): whatever was planned in odom is void.
                start_m = pose.position_m[:2]
            to_go_m = start_m + GOAL_M - pose.position_m[:2]
            print(f"drive: {np.linalg.norm(to_go_m):.2f} m to go", flush=True)
        time.sleep(PERIOD_S)
