"""Read poses, images and points from Python, newest first.

    from vo_service import PoseClient

    with PoseClient() as client:
        for pose in client.poses():
            print(pose.stamp_s, pose.position_m, pose.state)

Needs only zenoh and numpy. `docs/guide/python.md` describes the client.
"""

from vo_service.client.pose_client import PoseClient

__all__ = ["PoseClient"]
