"""Say how the service is, whenever that changes.

Usage: python watch_status.py [ENDPOINT]
"""

import sys

from vo_service.client import PoseClient

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450"

with PoseClient(connect=endpoint) as client:
    if not client.wait_for_publisher(timeout_s=1.0):
        print("waiting for kinect-vo", flush=True)
    said = None
    for status in client.statuses():
        news = (status["state"], status["reason"], *status["warnings"])
        if news != said:
            said = news
            about = [f"{status['fps']:.0f} poses a second", *filter(None, news[1:])]
            print(f"{status['state']}: {'; '.join(about)}", flush=True)
