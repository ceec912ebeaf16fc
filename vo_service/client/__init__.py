"""Read poses from Python, newest first and with their age.

    from vo_service import PoseClient

    with PoseClient() as client:
        for pose in client.poses():
            print(pose.stamp_s, pose.position_m, pose.state)

Needs only zenoh and numpy. `docs/guide/python.md` describes the client.
"""

from drivers.core.errors import InputError
from vo_service.client.client import PoseClient
from vo_service.client.errors import (
    CommandRefused,
    PoseUnavailable,
    PoseUnavailableReason,
    ServiceUnavailable,
)
from vo_service.client.map_odom import MapOdom
from vo_service.client.pose import Pose

__all__ = [
    "CommandRefused",
    "InputError",
    "MapOdom",
    "Pose",
    "PoseClient",
    "PoseUnavailable",
    "PoseUnavailableReason",
    "ServiceUnavailable",
]
