"""The compared depth-only ICP methods: ours, OpenCV's and Open3D's."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.errors import InputError
from drivers.core.geometry import Array, inverse
from vo_service.odometry.icp.alignment import FINE_ONLY, align
from vo_service.odometry.icp.depth_pyramid import build_depth_pyramid
from vo_service.odometry.icp.odometry import IcpOdometry
from vo_service.odometry.icp.parameters import IcpParameters
from vo_service.odometry.icp.quality import rejection_reason
from vo_service.odometry.icp.track import IcpTrack, start_track
from vo_service.tools.benchmark.baselines.frame_to_frame import FrameToFrameOdometry
from vo_service.tools.benchmark.baselines.open3d_odometry import Open3dIcp
from vo_service.tools.benchmark.baselines.opencv_odometry import OpenCvOdometry
from vo_service.types import Odometry

OURS, OURS_FRAME_TO_FRAME = "ours", "ours, frame to frame"
OPENCV, OPEN3D = "cv2.Odometry DEPTH", "Open3D point-to-plane"


def load_open3d(folder: Path) -> ModuleType:
    """Import Open3D from a separate folder. Raises InputError if it is not there."""
    sys.path.append(str(folder))
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        raise InputError(
            f"{folder}: cannot import Open3D from there ({error}); install it by "
            f"`pip install --target {folder} open3d-cpu`, or omit --open3d"
        ) from error


class FrameToFrameIcp:
    """Our kernels with the last frame as the reference, without a keyframe."""

    def prepare(self, frame: RgbdFrame) -> IcpTrack:
        """Compute the frame's planes."""
        return start_track(build_depth_pyramid(frame), IcpParameters().max_planes)

    def align(self, earlier: IcpTrack, later: IcpTrack, T_earlier_later: Array) -> Array | None:
        """Align as `IcpOdometry`, without a retry."""
        alignment = align(
            earlier.planes, later.last_frame, [inverse(T_earlier_later), np.eye(4)], FINE_ONLY
        )
        return None if rejection_reason(alignment) else inverse(alignment.T_camera_reference)


def make_methods(
    open3d_folder: Path | None, frame_to_frame: bool
) -> dict[str, Callable[[], Odometry]]:
    """Factories of the methods by name."""
    made: dict[str, Callable[[], Odometry]] = {OURS: IcpOdometry}
    if frame_to_frame:
        made[OURS_FRAME_TO_FRAME] = lambda: FrameToFrameOdometry(FrameToFrameIcp())
    made[OPENCV] = lambda: FrameToFrameOdometry(OpenCvOdometry(cv2.OdometryType_DEPTH))
    if open3d_folder is not None:
        open3d = load_open3d(open3d_folder)
        made[OPEN3D] = lambda: FrameToFrameOdometry(Open3dIcp(open3d))
    return made
