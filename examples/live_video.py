"""Write live video with the pose in each image.

Usage: python live_video.py VIDEO.avi FRAMES [ENDPOINT]
"""

import sys
from itertools import islice

import cv2

from vo_service import FrameClient, FrameUnavailable, InputError

if len(sys.argv) < 3 or not sys.argv[2].isdecimal():
    sys.exit(__doc__)
endpoint = sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7450"
video = cv2.VideoWriter()

try:
    with FrameClient(connect=endpoint) as client:
        for frame in islice(client.frames(timeout_s=10.0, depth=False), int(sys.argv[2])):
            image = frame.color_bgr.copy()
            x, y, z = frame.pose.position_m
            text = f"{frame.pose.state}: {x:.2f} {y:.2f} {z:.2f} m"
            cv2.putText(image, text, (10, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 255, 0), 2)
            if not video.isOpened():
                size = (image.shape[1], image.shape[0])
                video.open(sys.argv[1], cv2.VideoWriter.fourcc(*"MJPG"), 30.0, size)
            video.write(image)  # with opencv-python also cv2.imshow
except FrameUnavailable as error:
    sys.exit(f"ten seconds without a frame: {error}")
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
finally:
    video.release()
