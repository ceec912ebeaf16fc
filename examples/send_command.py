"""Reset the odometry at a known pose, such as that of the robot's charger.

Usage: python send_command.py [ENDPOINT]
"""

import sys

import numpy as np

from vo_service import CommandRefused, InputError, PoseClient, ServiceUnavailable
from vo_service.types.commands import ResetCommand

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

T_odom_charger = np.array(
    [
        [0.0, -1.0, 0.0, 2.0],  # turned to the left, 2 m ahead of odom's origin
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
)

try:
    with PoseClient(connect=endpoint) as client:
        epoch = client.send(ResetCommand.to_pose(T_odom_charger)).epoch
        print(f"epoch {epoch} begins at the charger", flush=True)
except CommandRefused as error:
    sys.exit(f"refused ({error.code}): {error}")
except (InputError, KeyboardInterrupt, ServiceUnavailable) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
