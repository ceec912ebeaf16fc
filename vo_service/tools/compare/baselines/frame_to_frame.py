"""Odometry from methods that align two frames: those of OpenCV, Open3D and small_gicp."""

from collections.abc import Callable
from math import sqrt
from types import ModuleType
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.features.extractor import Features
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry, StageTimer

# After this many failed frames, tracking is reset, as in `SurfOdometry`.
MAX_FAILURES = 30
# Voxel size, neighbors and radius for normals, and maximum distance of a pair. Voxels of 3 cm
# cost three times as much for the same accuracy.
VOXEL_M, NORMAL_NEIGHBORS, NORMAL_RADIUS_M, MAX_PAIR_DISTANCE_M = 0.05, 30, 0.125, 0.1
ITERATIONS = 30
# Minimum fraction of points with a pair; otherwise the frame fails.
MIN_FITNESS = 0.3
# The hybrid odometry ignores larger depths, where a Kinect's depth is mostly noise.
MAX_DEPTH_M = 4.0
# Pixel step, voxel size, neighbors for covariances, and maximum distance of a pair. Of those tried
# (2 and 4 pixels, 3 and 5 cm, 10 and 20 neighbors), these are the most accurate on a real and a
# rendered recording, at a medium cost.
PIXEL_STEP, GICP_VOXEL_M, COVARIANCE_NEIGHBORS, GICP_PAIR_DISTANCE_M = 4, 0.03, 20, 0.1


class PairwiseMethod(Protocol):
    """Method that aligns two frames."""

    def prepare(self, frame: RgbdFrame) -> Any:
        """Prepare a frame for alignment, as the later and as the earlier one."""
        ...

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Return the 4x4 T_earlier_later from a predicted one, or None on failure."""
        ...


class FrameToFrameOdometry:
    """Odometry that aligns each frame with the last good one, with a constant-velocity prediction.

    Failed frames are skipped.
    """

    def __init__(self, method: PairwiseMethod) -> None:
        self._method = method
        self._reference: Any = None
        self._T_world_reference = np.eye(4)
        self._T_reference_camera = np.eye(4)
        self._failures = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose from this frame and the last good one."""
        prepared = self._method.prepare(frame)
        if self._reference is None:
            return self._accept(prepared, np.eye(4))
        step = self._method.align(self._reference, prepared, self._T_reference_camera)
        return self._reject(prepared) if step is None else self._accept(prepared, step)

    def _accept(self, prepared: Any, step: Array, restarted: bool = False) -> Estimate:
        self._reference = prepared
        self._T_reference_camera = step
        self._T_world_reference = self._T_world_reference @ step
        self._failures = 0
        return self._make_estimate("", step, restarted)

    def _reject(self, prepared: Any) -> Estimate:
        self._failures += 1
        self._T_reference_camera = np.eye(4)
        if self._failures > MAX_FAILURES:
            return self._accept(prepared, np.eye(4), restarted=True)
        return self._make_estimate("no alignment", np.eye(4))

    def _make_estimate(self, reason: str, step: Array, restarted: bool = False) -> Estimate:
        """Make an estimate without covariance, because these methods give none."""
        unknown = np.zeros((6, 6))
        pose = self._T_world_reference.copy()
        return Estimate(not reason, reason, pose, step, unknown, is_reset=restarted)


class OpenCvOdometry:
    """`PairwiseMethod` of `cv2.Odometry`.

    Attributes:
        kind: cv2.OdometryType_RGB, _RGB_DEPTH or _DEPTH.
    """

    def __init__(self, kind: int) -> None:
        self._kind = kind
        self._odometry: Any = None

    def prepare(self, frame: RgbdFrame) -> Any:
        """Compute OpenCV's pyramids, gradients and normals, once per frame."""
        if self._odometry is None:
            settings = cv2.OdometrySettings()
            settings.setCameraMatrix(frame.camera.K.astype(np.float32))
            self._odometry = cv2.Odometry(self._kind, settings, cv2.OdometryAlgoType_COMMON)
        depth_m = np.where(frame.depth_m > 0, frame.depth_m, np.float32(np.nan))
        prepared = cv2.OdometryFrame(depth_m, frame.color_bgr)
        self._odometry.prepareFrame(prepared)
        return prepared

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Align the later frame with the earlier one, without a prediction.

        The opposite order is less accurate on all recordings tried.
        """
        succeeded, T_result = self._odometry.compute(later, earlier)
        return np.asarray(T_result, np.float64) if succeeded else None


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


class SmallGicp:
    """`PairwiseMethod` of generalized ICP on downsampled clouds."""

    def __init__(self, small_gicp: ModuleType) -> None:
        self._gicp = small_gicp

    def prepare(self, frame: RgbdFrame) -> Any:
        """Make a downsampled cloud with covariances, and its search tree."""
        return self._gicp.preprocess_points(
            sample_points(frame),
            downsampling_resolution=GICP_VOXEL_M,
            num_neighbors=COVARIANCE_NEIGHBORS,
        )

    def align(self, earlier: Any, later: Any, T_earlier_later: Array) -> Array | None:
        """Align two clouds, distribution to distribution."""
        (target, tree), (source, _) = earlier, later
        if not (target.size() and source.size()):
            return None
        result = self._gicp.align(
            target,
            source,
            tree,
            T_earlier_later,
            registration_type="GICP",
            max_correspondence_distance=GICP_PAIR_DISTANCE_M,
        )
        good = result.converged and result.num_inliers >= MIN_FITNESS * source.size()
        return np.array(result.T_target_source, np.float64) if good else None


def sample_points(frame: RgbdFrame) -> NDArray[np.float64]:
    """Return (N, 3) points in optical axes, m, of every fourth column and row with depth."""
    camera = frame.camera
    z_m = frame.depth_m[::PIXEL_STEP, ::PIXEL_STEP].astype(np.float64)
    v, u = np.nonzero(z_m)
    z_m = z_m[v, u]
    x_m = (PIXEL_STEP * u - camera.cx) / camera.fx * z_m
    y_m = (PIXEL_STEP * v - camera.cy) / camera.fy * z_m
    return np.column_stack([x_m, y_m, z_m])


# Lowe's ratio, for each method's own distance. ORB's is the number of different bits, which is
# the square of the distance between vectors of 0 and 1.
MATCH_RATIO = 0.8


class OpenCvExtractor:
    """Extractor of OpenCV features; descriptors are float32 vectors, with one element per bit."""

    def __init__(
        self, create: Callable[[int], cv2.Feature2D], count: int, binary: bool = False
    ) -> None:
        """Set the method: `create` makes a detector with a maximum number of features."""
        self._create = create
        self._binary = binary
        self.count = count

    @property
    def count(self) -> int:
        """Maximum number of features."""
        return self._count

    @count.setter
    def count(self, count: int) -> None:
        self._count = count
        self._detector = self._create(count)

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Extract features of a (H, W) image. All signs are +1, so all features are compared."""
        keypoints, descriptors = self._detector.detectAndCompute(gray, None)
        n = len(keypoints)
        size = self._detector.descriptorSize()
        table = np.asarray(descriptors if n else np.empty((0, size)), np.float32)
        if self._binary:
            table = np.unpackbits(table.astype(np.uint8), axis=1).astype(np.float32)
        angle_rad = np.radians([k.angle for k in keypoints])
        return Features(
            position_px=np.array([k.pt for k in keypoints], np.float32).reshape(-1, 2),
            scale_px=np.array([k.size for k in keypoints], np.float32),
            direction=np.column_stack([np.cos(angle_rad), np.sin(angle_rad)]).astype(np.float32),
            response=np.array([k.response for k in keypoints], np.float32),
            sign=np.ones(n, np.float32),
            descriptor=table,
        )


def sift_odometry(count: int, stopwatch: StageTimer) -> SurfOdometry:
    """Make a `SurfOdometry` with SIFT features (Lowe 2004)."""
    extractor = OpenCvExtractor(cv2.SIFT_create, count)  # type: ignore[attr-defined]
    return SurfOdometry(extractor, SurfParameters(match_ratio=MATCH_RATIO), timer=stopwatch)


def orb_odometry(count: int, stopwatch: StageTimer) -> SurfOdometry:
    """Make a `SurfOdometry` with ORB features (Rublee et al. 2011)."""
    extractor = OpenCvExtractor(cv2.ORB_create, count, binary=True)  # type: ignore[attr-defined]
    return SurfOdometry(extractor, SurfParameters(match_ratio=sqrt(MATCH_RATIO)), timer=stopwatch)


def make_baseline(
    name: str, library: ModuleType, feature_count: int, stopwatch: StageTimer
) -> Odometry:
    """Make a baseline other than ORB-SLAM3; the count is for those that use features."""
    method: PairwiseMethod
    match name:
        case "sift":
            return sift_odometry(feature_count, stopwatch)
        case "orb":
            return orb_odometry(feature_count, stopwatch)
        case "open3d-icp":
            method = Open3dIcp(library)
        case "open3d-hybrid":
            method = Open3dHybrid(library)
        case "small-gicp":
            method = SmallGicp(library)
        case _:
            kind = name.removeprefix("cv2-").replace("-", "_").upper()
            method = OpenCvOdometry(getattr(library, f"OdometryType_{kind}"))
    return FrameToFrameOdometry(method)
