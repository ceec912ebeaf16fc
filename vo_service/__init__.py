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

`docs/guide/python.md` shows more. A name's libraries are imported when it is first used: Zenoh for
the client, OpenCV and Numba for the odometry.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn

__all__ = [
    "METHODS",
    "CommandRefused",
    "Estimate",
    "Frame",
    "FrameClient",
    "FrameUnavailable",
    "InputError",
    "MapOdom",
    "Odometry",
    "PointCloud",
    "Pose",
    "PoseClient",
    "PoseUnavailable",
    "PoseUnavailableReason",
    "ServiceUnavailable",
    "make_odometry",
]

if TYPE_CHECKING:
    from drivers.core import InputError
    from vo_service.client import PoseClient
    from vo_service.client.connection import (
        CommandRefused,
        FrameUnavailable,
        PoseUnavailable,
        PoseUnavailableReason,
        ServiceUnavailable,
    )
    from vo_service.client.frame_client import Frame, FrameClient, PointCloud
    from vo_service.client.pose import MapOdom, Pose
    from vo_service.odometry import METHODS, make_odometry
    from vo_service.types import Estimate, Odometry

# Where each name is; mypy and editors see the imports above instead.
_MODULES = {
    "METHODS": "vo_service.odometry",
    "CommandRefused": "vo_service.client.connection",
    "Estimate": "vo_service.types",
    "InputError": "drivers.core",
    "Frame": "vo_service.client.frame_client",
    "FrameClient": "vo_service.client.frame_client",
    "FrameUnavailable": "vo_service.client.connection",
    "PointCloud": "vo_service.client.frame_client",
    "MapOdom": "vo_service.client.pose",
    "Odometry": "vo_service.types",
    "Pose": "vo_service.client.pose",
    "PoseClient": "vo_service.client",
    "PoseUnavailable": "vo_service.client.connection",
    "PoseUnavailableReason": "vo_service.client.connection",
    "ServiceUnavailable": "vo_service.client.connection",
    "make_odometry": "vo_service.odometry",
}

if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import a public name when it is first used (PEP 562)."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return __all__


# The same as in `vo_service.signals`, which is not imported yet.
_EXIT_CODE_SIGINT = 130


def main() -> NoReturn:
    """Run ``kinect-vo``; handle Ctrl-C also while the command line is being imported."""
    try:
        from vo_service.cli import main as run_command

        run_command()
    except KeyboardInterrupt:
        sys.exit(_EXIT_CODE_SIGINT)
