"""Read poses, images and points from Python, newest first.

    from vo_service import PoseClient

    with PoseClient() as client:
        for pose in client.poses():
            print(pose.stamp_s, pose.position_m, pose.state)

Needs only zenoh and numpy. `docs/guide/python.md` describes the client.
"""

from drivers.core.errors import InputError
from vo_service.client.client import PoseClient
from vo_service.client.connection import (
    CommandRefused,
    FrameUnavailable,
    PoseUnavailable,
    PoseUnavailableReason,
    ServiceUnavailable,
)
from vo_service.client.frame_client import Frame, FrameClient, PointCloud
from vo_service.client.pose import MapOdom, Pose

__all__ = [
    "CommandRefused",
    "Frame",
    "FrameClient",
    "FrameUnavailable",
    "InputError",
    "MapOdom",
    "PointCloud",
    "Pose",
    "PoseClient",
    "PoseUnavailable",
    "PoseUnavailableReason",
    "ServiceUnavailable",
]
