"""Open3D, frame to frame: point-to-plane ICP on depth, and hybrid RGB-D odometry."""

from types import ModuleType
from typing import Any

import cv2
import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array

# Voxel size, neighbors and radius for normals, and maximum distance of a pair. Voxels of 3 cm
# cost three times as much for the same accuracy.
VOXEL_M, NORMAL_NEIGHBORS, NORMAL_RADIUS_M, MAX_PAIR_DISTANCE_M = 0.05, 30, 0.125, 0.1
ITERATIONS = 30
# Minimum fraction of points with a pair; otherwise the frame fails.
MIN_FITNESS = 0.3
# The hybrid odometry ignores larger depths, where a Kinect's depth is mostly noise.
MAX_DEPTH_M = 4.0


class Open3dIcp:
    """`PairwiseMethod` of point-to-plane ICP on downsampled clouds with Tukey's weights."""

    def __init__(self, open3d: ModuleType) -> None:
        self._o3d = open3d

    def prepare(self, frame: RgbdFrame) -> Any:
        """Make a downsampled point cloud with normals."""
        o3d = self._o3d
        cloud = o3d.geometry.PointCloud.create_from_depth_image(
            o3d.geometry.Image(frame.depth_raw),
            _intrinsics(o3d, frame.camera),
            depth_scale=frame.depth_factor,
        ).voxel_down_sample(VOXEL_M)
        search = o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS_M, NORMAL_NEIGHBORS)
        cloud.estimate_normals(search)
        return cloud

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Align two clouds by nearest neighbors, point to plane."""
        registration = self._o3d.pipelines.registration
        kernel = registration.TukeyLoss(k=MAX_PAIR_DISTANCE_M / 2)
        result = registration.registration_icp(
            later,
            earlier,
            MAX_PAIR_DISTANCE_M,
            T_earlier_later,
            registration.TransformationEstimationPointToPlane(kernel),
            registration.ICPConvergenceCriteria(max_iteration=ITERATIONS),
        )
        good = result.fitness >= MIN_FITNESS
        return np.array(result.transformation, np.float64) if good else None


class Open3dHybrid:
    """`PairwiseMethod` of RGB-D odometry with the hybrid term (Park, Zhou and Koltun 2017).

    Open3D computes the pyramids for each pair again; it cannot reuse them.
    """

    def __init__(self, open3d: ModuleType) -> None:
        self._o3d = open3d
        self._odometry = open3d.pipelines.odometry
        self._intrinsics: Any = None

    def prepare(self, frame: RgbdFrame) -> Any:
        """Make an image of intensity and depth in meters."""
        o3d = self._o3d
        if self._intrinsics is None:
            self._intrinsics = _intrinsics(o3d, frame.camera)
        color_rgb = cv2.cvtColor(frame.color_bgr, cv2.COLOR_BGR2RGB)
        return o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(color_rgb),
            o3d.geometry.Image(frame.depth_raw),
            depth_scale=frame.depth_factor,
            depth_trunc=MAX_DEPTH_M,
        )

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Align two images from coarse to fine, with Open3D's default settings."""
        succeeded, T_result, information = self._odometry.compute_rgbd_odometry(
            later,
            earlier,
            self._intrinsics,
            T_earlier_later,
            self._odometry.RGBDOdometryJacobianFromHybridTerm(),
            self._odometry.OdometryOption(),
        )
        # It calls nearly everything a success; its information matrix ends with the pairs' number.
        readings = np.count_nonzero(np.asarray(later.depth))
        good = succeeded and information[5, 5] > MIN_FITNESS * readings > 0
        return np.array(T_result, np.float64) if good else None


def _intrinsics(open3d: ModuleType, camera: PinholeCamera) -> Any:
    return open3d.camera.PinholeCameraIntrinsic(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    )
