"""Send the odometry of a simulated base: it drives in a circle on wheels that are not exact.

The service must have `enabled = true` in `[wheel_odometry]`. With --slip, the wheels spin for half
a second every ten seconds: the service then warns, if the camera sees that the robot does not move
as they tell.

Usage: python simulated_base.py [--slip] [ENDPOINT]
"""

import math
import sys
import time

import numpy as np

from vo_service import InputError, PoseClient

RATE_HZ = 50
SPEED_M_S, YAW_RAD_S = 0.2, 0.4
# The wheels' radius and track are known to a few percent; each step has noise besides.
SCALE, YAW_SCALE, NOISE = 1.02, 1.03, 0.02
SLIP_PERIOD_S, SLIP_S, SLIP_FACTOR = 10.0, 0.5, 1.4

has_slip = "--slip" in sys.argv
arguments = [argument for argument in sys.argv[1:] if argument != "--slip"]
endpoint = arguments[0] if arguments else "tcp/127.0.0.1:7450"
random = np.random.default_rng(1)

try:
    with PoseClient(connect=endpoint) as client:
        client.wait_for_publisher()
        x_m = y_m = yaw_rad = 0.0
        start_s = last_s = time.time()
        while True:
            time.sleep(1 / RATE_HZ)
            now_s = time.time()
            step_s, last_s = now_s - last_s, now_s
            slips = has_slip and (now_s - start_s) % SLIP_PERIOD_S < SLIP_S
            noise, yaw_noise = 1 + NOISE * random.standard_normal(2)
            speed_m_s = SPEED_M_S * SCALE * noise * (SLIP_FACTOR if slips else 1.0)
            turn_rad_s = YAW_RAD_S * YAW_SCALE * yaw_noise
            x_m += speed_m_s * step_s * math.cos(yaw_rad)
            y_m += speed_m_s * step_s * math.sin(yaw_rad)
            yaw_rad += turn_rad_s * step_s
            client.send_wheel_odometry(now_s, x_m, y_m, yaw_rad, (speed_m_s, 0.0, turn_rad_s))
            print(f"{now_s:.2f} {x_m:.3f} {y_m:.3f} {yaw_rad:.3f}{' slip' * slips}", flush=True)
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
