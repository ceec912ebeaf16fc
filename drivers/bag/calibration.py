"""Cameras of a bag: intrinsics from CameraInfo, and transforms from /tf and /tf_static."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np

from drivers.bag.bag_file import stamp_ns_of
from drivers.calibration import (
    MILLIMETERS_PER_METER,
    NO_DISTORTION,
    CameraCalibration,
    DepthCameraCalibration,
    RigidTransform,
)
from drivers.core import InputError
from drivers.core.geometry import (
    Array,
    Trajectory,
    inverse,
    nearest_indices,
    quaternion_from_rotation,
    transform_from_pose,
)
from drivers.plausibility import find_intrinsics_error


def camera_from_message(info: Any, is_rectified: bool, location: str) -> CameraCalibration:
    """Convert a CameraInfo, which tells neither the timing nor the unit of depth.

    Args:
        info: The message, of ROS 1 or ROS 2.
        is_rectified: Whether its images are undistorted, so that the projection matrix counts.
        location: File and topic, for error messages.

    Raises:
        InputError: The camera is not calibrated, its intrinsics are impossible, or its lens has
            another model than Brown's.
    """
    K, D, P = (_values(info, name) for name in "kdp")
    fx, fy, cx, cy = (P[0], P[5], P[2], P[6]) if is_rectified else (K[0], K[4], K[2], K[5])
    fault = _find_fault(info, (fx, fy, cx, cy), [] if is_rectified else D, "KP"[is_rectified])
    if fault:
        raise InputError(
            f"{location}: the camera is not calibrated ({fault}); give the camera file with "
            "--camera-file"
        )
    distortion = NO_DISTORTION
    if not is_rectified and any(D):
        if any(D[5:]) or info.distortion_model not in ("plumb_bob", "rational_polynomial", ""):
            raise InputError(
                f"{location}: the lens model {info.distortion_model} with {len(D)} coefficients is "
                "not supported; use the rectified images (image_rect), or give --camera-file FILE"
            )
        k1, k2, p1, p2, k3 = [*D, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
        distortion = (k1, k2, p1, p2, k3)
    size = int(info.width), int(info.height)
    camera = CameraCalibration(*size, fx, fy, cx, cy, distortion, MILLIMETERS_PER_METER)
    if (error := find_intrinsics_error(camera.pinhole)) is not None:
        raise InputError(
            f"{location}: {error[0]} = {error[1]}; --camera-file FILE replaces the topic"
        )
    return camera


def make_depth_camera(camera: CameraCalibration, T_color_depth: Array) -> DepthCameraCalibration:
    """Make the depth camera from its CameraInfo and its pose relative to the color camera."""
    x, y, z = T_color_depth[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_from_rotation(T_color_depth[:3, :3]).tolist()
    return DepthCameraCalibration(
        *(camera.fx, camera.fy, camera.cx, camera.cy),
        RigidTransform((x, y, z), (qx, qy, qz, qw)),
        camera.distortion,
        camera.width,
        camera.height,
    )


def _find_fault(info: Any, intrinsics: Sequence[float], D: list[float], matrix: str) -> str:
    """Return why a CameraInfo has no calibration; "" if it has one."""
    if not (info.width and info.height):
        return f"its size is {info.width}x{info.height}"
    if not any(intrinsics):
        return f"its {matrix} is zero"
    if not all(map(math.isfinite, (*intrinsics, *D))):
        return f"its {matrix} or D is not finite"
    fx, fy = intrinsics[:2]
    return "" if fx > 0 and fy > 0 else f"its focal length is {fx:g} and {fy:g}"


def _values(info: Any, name: str) -> list[float]:
    """Return a matrix of the message as a list. ROS 1 has upper-case names."""
    matrix = getattr(info, name, None)
    return [float(value) for value in (getattr(info, name.upper()) if matrix is None else matrix)]


# Larger changes of a transform are motion: its elements in meters, or without unit.
MAX_CONSTANT_CHANGE = 1e-6
MAX_CHAIN_LENGTH = 50
# Frames in which a robot estimates its poses (REP 105).
ESTIMATE_FRAMES = ("odom", "map")


def frame_name(frame_id: str) -> str:
    """Return a frame's name without the leading slash that ROS once used."""
    return frame_id.lstrip("/")


def matrix_from_message(translation: Any, rotation: Any) -> Array | None:
    """Make a 4x4 transform from a message's translation and rotation; None if it is no rotation."""
    position = [translation.x, translation.y, translation.z]
    quaternion = [rotation.x, rotation.y, rotation.z, rotation.w]
    if not np.isfinite([*position, *quaternion]).all():
        return None
    try:
        return transform_from_pose(position, quaternion)
    except ValueError:
        return None


@dataclass
class _Edge:
    """Samples of the transform from one frame to its parent."""

    parent: str
    stamps_s: list[float] = field(default_factory=list)
    T_parent_child: list[Array] = field(default_factory=list)

    @property
    def is_constant(self) -> bool:
        return bool(np.ptp(self.T_parent_child, axis=0).max() <= MAX_CONSTANT_CHANGE)

    def sorted(self) -> Trajectory:
        stamps_s, first = np.unique(self.stamps_s, return_index=True)
        return Trajectory(stamps_s, np.array(self.T_parent_child)[first])


class TransformTree:
    """Collects transforms. If a frame has two parents, the one with more samples counts."""

    def __init__(self) -> None:
        self._edges: dict[str, dict[str, _Edge]] = defaultdict(dict)

    def add(self, message: Any) -> None:
        """Add the transforms of a TFMessage."""
        for each in message.transforms:
            T = matrix_from_message(each.transform.translation, each.transform.rotation)
            if T is None:
                continue
            parent, child = frame_name(each.header.frame_id), frame_name(each.child_frame_id)
            edge = self._edges[child].setdefault(parent, _Edge(parent))
            edge.stamps_s.append(float(Decimal(stamp_ns_of(each)).scaleb(-9)))
            edge.T_parent_child.append(T)

    def constant_transform(self, to_frame: str, from_frame: str) -> Array | None:
        """Return the 4x4 transform that maps `from_frame` to `to_frame`; None if it moves."""
        paths = [self._path_to_root(frame_name(each)) for each in (to_frame, from_frame)]
        ancestors = [
            [frame_name(name), *(edge.parent for edge in path)]
            for name, path in zip((to_frame, from_frame), paths, strict=True)
        ]
        common = next((frame for frame in ancestors[0] if frame in ancestors[1]), None)
        if common is None:
            return None
        matrices = []
        for path, frames in zip(paths, ancestors, strict=True):
            edges = path[: frames.index(common)]
            if not all(edge.is_constant for edge in edges):
                return None
            T_common_frame = np.eye(4)
            for edge in edges:
                T_common_frame = edge.T_parent_child[0] @ T_common_frame
            matrices.append(T_common_frame)
        return inverse(matrices[0]) @ matrices[1]

    def trajectory(self, frame: str) -> tuple[Trajectory, str] | None:
        """Return the true motion of a frame in the root of its tree, and the root's name.

        It has a pose at each sample of the moving transform that has the most; others contribute
        their nearest sample. None if nothing moves, or if `odom` or `map` is on the way: then it is
        an estimate.
        """
        path = self._path_to_root(frame_name(frame))
        moving = [edge for edge in path if not edge.is_constant]
        if not moving or any(edge.parent in ESTIMATE_FRAMES for edge in path):
            return None
        stamps_s = max((edge.sorted().stamps_s for edge in moving), key=len)
        T = np.tile(np.eye(4), (len(stamps_s), 1, 1))
        for edge in path:
            samples = edge.sorted()
            T = samples.T_world_camera[nearest_indices(samples.stamps_s, stamps_s)] @ T
        return Trajectory(stamps_s, T), path[-1].parent

    def _path_to_root(self, frame: str) -> list[_Edge]:
        path: list[_Edge] = []
        while frame in self._edges and len(path) < MAX_CHAIN_LENGTH:
            path.append(max(self._edges[frame].values(), key=lambda edge: len(edge.stamps_s)))
            frame = path[-1].parent
        return path
