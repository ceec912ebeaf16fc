"""Other people's depth-only ICP in the place of ours: OpenCV's and Open3D's, frame to frame."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import cv2
import numpy as np

from drivers.camera import RgbdFrame
from drivers.errors import InputError
from drivers.geometry import Array, inverse
from vo_service.odometry.estimate import Estimate, Odometry
from vo_service.odometry.icp.alignment import FINE_ALONE, align
from vo_service.odometry.icp.confidence import doubt
from vo_service.odometry.icp.parameters import IcpParameters
from vo_service.odometry.icp.pyramid import make_pyramid
from vo_service.odometry.icp.track import Track, track_from
from vo_service.odometry.icp_odometry import IcpOdometry

OURS, OURS_FRAME_TO_FRAME = "ours", "ours, frame to frame"
OPENCV, OPEN3D = "cv2.Odometry DEPTH", "Open3D point-to-plane"

# Open3D: voxels of this size, normals from this many neighbours within this distance, and pairs
# no further apart than this. Voxels of 3 cm cost three times as much for the same accuracy.
VOXEL_M, NEIGHBOURS, NORMAL_RADIUS_M, PAIR_M = 0.05, 30, 0.125, 0.1
ITERATIONS = 30
# Of its points, so many at least find a pair; else the frame has failed.
LEAST_FITNESS = 0.3


class PairwiseMethod(Protocol):
    """Aligns two frames."""

    def prepare(self, frame: RgbdFrame) -> Any:
        """What is needed of a frame, both as the later and as the earlier one."""
        ...

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """4x4 T_earlier_later from an expected one; None without success."""
        ...


class FrameToFrame:
    """An odometry of a method that aligns two frames; it starts at the last motion."""

    def __init__(self, method: PairwiseMethod) -> None:
        self._method = method
        self._last: Any = None
        self._T_world_last = np.eye(4)
        self._step = np.eye(4)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """A frame that fails is left out."""
        view = self._method.prepare(frame)
        step = np.eye(4)
        if self._last is not None:
            found = self._method.align(self._last, view, self._step)
            if found is None:
                self._step = np.eye(4)
                return self._answer("no alignment", np.eye(4))
            step = self._step = found
        self._last = view
        self._T_world_last = self._T_world_last @ step
        return self._answer("", step)

    def _answer(self, reason: str, step: Array) -> Estimate:
        return Estimate(not reason, reason, self._T_world_last, step, np.zeros((6, 6)))


class OpenCv:
    """cv2.Odometry on depth, with its own settings but for the intrinsics."""

    def __init__(self) -> None:
        self._odometry: Any = None

    def prepare(self, frame: RgbdFrame) -> Any:
        """Its own pyramids and normals, once a frame."""
        if self._odometry is None:
            settings = cv2.OdometrySettings()
            settings.setCameraMatrix(frame.camera.K.astype(np.float32))
            kind, way = cv2.OdometryType_DEPTH, cv2.OdometryAlgoType_COMMON
            self._odometry = cv2.Odometry(kind, settings, way)
        depth_m = np.where(frame.depth_m > 0, frame.depth_m, np.float32(np.nan))
        prepared = cv2.OdometryFrame(depth_m)
        self._odometry.prepareFrame(prepared)
        return prepared

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """It takes no start."""
        found, T_later_earlier = self._odometry.compute(earlier, later)
        return inverse(np.asarray(T_later_earlier, np.float64)) if found else None


class Open3d:
    """Its point-to-plane ICP on thinned clouds, robust by Tukey's weights."""

    def __init__(self, open3d: ModuleType) -> None:
        self._o3d = open3d

    def prepare(self, frame: RgbdFrame) -> Any:
        """A thinned cloud with normals."""
        o3d, camera = self._o3d, frame.camera
        intrinsics = o3d.camera.PinholeCameraIntrinsic(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        )
        cloud = o3d.geometry.PointCloud.create_from_depth_image(
            o3d.geometry.Image(frame.depth_raw), intrinsics, depth_scale=frame.depth_factor
        ).voxel_down_sample(VOXEL_M)
        near = o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS_M, NEIGHBOURS)
        cloud.estimate_normals(near)
        return cloud

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Nearest neighbours, point to plane."""
        registration = self._o3d.pipelines.registration
        kernel = registration.TukeyLoss(k=PAIR_M / 2)
        found = registration.registration_icp(
            later,
            earlier,
            PAIR_M,
            T_earlier_later,
            registration.TransformationEstimationPointToPlane(kernel),
            registration.ICPConvergenceCriteria(max_iteration=ITERATIONS),
        )
        good = found.fitness >= LEAST_FITNESS
        return np.array(found.transformation, np.float64) if good else None


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
    made[OPENCV] = lambda: FrameToFrame(OpenCv())
    if open3d_folder is not None:
        open3d = load_open3d(open3d_folder)
        made[OPEN3D] = lambda: FrameToFrame(Open3d(open3d))
    return made
