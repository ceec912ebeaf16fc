"""Other people's depth-only ICP beside ours: OpenCV's and Open3D's, frame to frame."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from drivers.camera import RgbdFrame
from drivers.errors import InputError
from drivers.geometry import Array, inverse
from vo_service.bench.peers.frame_to_frame import FrameToFrame
from vo_service.bench.peers.open3d_methods import Open3dIcp
from vo_service.bench.peers.opencv import OpenCvOdometry
from vo_service.odometry.icp.alignment import FINE_ALONE, align
from vo_service.odometry.icp.confidence import doubt
from vo_service.odometry.icp.parameters import IcpParameters
from vo_service.odometry.icp.pyramid import make_pyramid
from vo_service.odometry.icp.track import Track, track_from
from vo_service.odometry.icp_odometry import IcpOdometry
from vo_service.types import Odometry

OURS, OURS_FRAME_TO_FRAME = "ours", "ours, frame to frame"
OPENCV, OPEN3D = "cv2.Odometry DEPTH", "Open3D point-to-plane"


def load_open3d(folder: Path) -> ModuleType:
    """Open3D from a folder of its own. Raises InputError if it is not there."""
    sys.path.append(str(folder))
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        raise InputError(
            f"{folder}: no Open3D there ({error}); put it there by "
            f"`pip install --target {folder} open3d-cpu`, or leave --open3d out"
        ) from error


class NewestReference:
    """Our kernels, with the last frame as the reference of each: what a staying one gains."""

    def prepare(self, frame: RgbdFrame) -> Track:
        """Its planes, though the first frame alone needs them at once."""
        return track_from(make_pyramid(frame), IcpParameters().planes)

    def align(self, earlier: Track, later: Track, T_earlier_later: Array) -> Array | None:
        """As `IcpOdometry`, without a second try."""
        found = align(earlier.planes, later.last, [inverse(T_earlier_later), np.eye(4)], FINE_ALONE)
        return None if doubt(found) else inverse(found.T_camera_reference)


def methods(open3d_folder: Path | None, frame_to_frame: bool) -> dict[str, Callable[[], Odometry]]:
    """By name, each ready to make."""
    made: dict[str, Callable[[], Odometry]] = {OURS: IcpOdometry}
    if frame_to_frame:
        made[OURS_FRAME_TO_FRAME] = lambda: FrameToFrame(NewestReference())
    made[OPENCV] = lambda: FrameToFrame(OpenCvOdometry(cv2.OdometryType_DEPTH))
    if open3d_folder is not None:
        open3d = load_open3d(open3d_folder)
        made[OPEN3D] = lambda: FrameToFrame(Open3dIcp(open3d))
    return made
