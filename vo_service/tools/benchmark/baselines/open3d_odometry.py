"""Open3D, frame to frame: its point-to-plane ICP on depth, its hybrid odometry on both images."""

from types import ModuleType
from typing import Any

import cv2
import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array

# Voxels of this size, normals from this many neighbours within this distance, and pairs no
# further apart than this. Voxels of 3 cm cost three times as much for the same accuracy.
VOXEL_M, NORMAL_NEIGHBORS, NORMAL_RADIUS_M, MAX_PAIR_DISTANCE_M = 0.05, 30, 0.125, 0.1
ITERATIONS = 30
# Of its points, so many at least find a pair; else the frame has failed.
MIN_FITNESS = 0.3
# What the hybrid odometry cuts off: a Kinect's depth beyond is mostly noise.
MAX_DEPTH_M = 4.0


class Open3dIcp:
    """Point-to-plane ICP on thinned clouds, robust by Tukey's weights; see `PairwiseMethod`."""

    def __init__(self, open3d: ModuleType) -> None:
        self._o3d = open3d

    def prepare(self, frame: RgbdFrame) -> Any:
        """A thinned cloud with normals."""
        o3d = self._o3d
        cloud = o3d.geometry.PointCloud.create_from_depth_image(
            o3d.geometry.Image(frame.depth_raw),
            _intrinsics(o3d, frame.camera),
            depth_scale=frame.depth_factor,
        ).voxel_down_sample(VOXEL_M)
        near = o3d.geometry.KDTreeSearchParamHybrid(NORMAL_RADIUS_M, NORMAL_NEIGHBORS)
        cloud.estimate_normals(near)
        return cloud

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Nearest neighbours, point to plane."""
        registration = self._o3d.pipelines.registration
        kernel = registration.TukeyLoss(k=MAX_PAIR_DISTANCE_M / 2)
        found = registration.registration_icp(
            later,
            earlier,
            MAX_PAIR_DISTANCE_M,
            T_earlier_later,
            registration.TransformationEstimationPointToPlane(kernel),
            registration.ICPConvergenceCriteria(max_iteration=ITERATIONS),
        )
        good = found.fitness >= MIN_FITNESS
        return np.array(found.transformation, np.float64) if good else None


class Open3dHybrid:
    """Its RGB-D odometry with the hybrid term (Park, Zhou and Koltun 2017); see `PairwiseMethod`.

    Pyramids are its own, and made anew for each pair: it offers no way to keep them.
    """

    def __init__(self, open3d: ModuleType) -> None:
        self._o3d = open3d
        self._odometry = open3d.pipelines.odometry
        self._intrinsics: Any = None

    def prepare(self, frame: RgbdFrame) -> Any:
        """Brightness and metres."""
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
        """From coarse to fine, with its own settings."""
        found, T_found, information = self._odometry.compute_rgbd_odometry(
            later,
            earlier,
            self._intrinsics,
            T_earlier_later,
            self._odometry.RGBDOdometryJacobianFromHybridTerm(),
            self._odometry.OdometryOption(),
        )
        # It calls nearly everything a success; its information matrix ends with the pairs' number.
        readings = np.count_nonzero(np.asarray(later.depth))
        good = found and information[5, 5] > MIN_FITNESS * readings > 0
        return np.array(T_found, np.float64) if good else None


def _intrinsics(open3d: ModuleType, camera: PinholeCamera) -> Any:
    return open3d.camera.PinholeCameraIntrinsic(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    )
