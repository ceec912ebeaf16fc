"""Print the state of the service whenever it changes.

Usage: python watch_status.py [ENDPOINT]
"""

import signal
import sys

from vo_service import InputError, PoseClient

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end without an error in `| head`
endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

try:
    with PoseClient(connect=endpoint) as client:
        if not client.wait_for_publisher(timeout_s=1.0):
            print("waiting for kinect-vo", flush=True)
        previous = None
        for status in client.statuses():
            current = (status["state"], status["reason"], *status["warnings"])
            if current != previous:
                previous = current
                details = [
                    f"{status['latency']['fps']:.0f} poses a second",
                    *filter(None, current[1:]),
                ]
                print(f"{status['state']}: {'; '.join(details)}", flush=True)
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
