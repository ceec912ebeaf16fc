"""Live visual odometry for RGB-D cameras, as a service and as a library.

Estimate the motion of a camera:

    from drivers import open_camera
    from vo_service import make_odometry

    odometry = make_odometry("direct")
    with open_camera("tum:recordings/desk") as camera:
        for frame in camera:
            print(frame.stamp_s, odometry.estimate(frame).T_world_camera[:3, 3])

Read the poses that a running service publishes:

    from vo_service import PoseClient

    with PoseClient() as client:
        for pose in client.poses():
            print(pose.stamp_s, pose.position_m, pose.state)

`docs/guide/python.md` shows more. Names, see `__init__.pyi`, and their libraries are imported
when they are first used: Zenoh for the client, OpenCV and Numba for the odometry.
"""

from drivers.core.lazy_imports import lazy_imports

__getattr__, __dir__, __all__ = lazy_imports(__name__, __file__)
