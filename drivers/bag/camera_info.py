"""Cameras of a bag, from sensor_msgs CameraInfo."""

from dataclasses import dataclass
from typing import Any

from drivers.calibration import (
    NO_DISTORTION,
    CameraCalibration,
    DepthCameraCalibration,
    Distortion,
    RigidTransform,
)
from drivers.core.errors import InputError
from drivers.core.geometry import Array, quaternion_from_rotation


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics of one topic: size in pixels, fx, fy, cx, cy and distortion."""

    width: int
    height: int
    intrinsics: tuple[float, float, float, float]
    distortion: Distortion

    def color_calibration(self, depth_factor: float) -> CameraCalibration:
        """Make the calibration; the timing is not known."""
        return CameraCalibration(
            self.width, self.height, *self.intrinsics, self.distortion, depth_factor
        )

    def depth_calibration(self, T_color_depth: Array) -> DepthCameraCalibration:
        """Make the depth camera, with its pose relative to the color camera."""
        x, y, z = T_color_depth[:3, 3].tolist()
        qx, qy, qz, qw = quaternion_from_rotation(T_color_depth[:3, :3]).tolist()
        return DepthCameraCalibration(
            *self.intrinsics,
            RigidTransform((x, y, z), (qx, qy, qz, qw)),
            self.distortion,
            self.width,
            self.height,
        )


def camera_from_message(info: Any, is_rectified: bool, location: str) -> CameraModel:
    """Convert a CameraInfo.

    Args:
        info: The message, of ROS 1 or ROS 2.
        is_rectified: Whether its images are undistorted, so that the projection matrix counts.
        location: File and topic, for error messages.

    Raises:
        InputError: The camera is not calibrated, or its lens has another model than Brown's.
    """
    K, D, P = (_values(info, name) for name in "kdp")
    fx, fy, cx, cy = (P[0], P[5], P[2], P[6]) if is_rectified else (K[0], K[4], K[2], K[5])
    if not (fx > 0 and fy > 0 and info.width and info.height):
        raise InputError(
            f"{location}: the camera is not calibrated (its K is zero); give the camera file with "
            "--camera"
        )
    distortion = NO_DISTORTION
    if not is_rectified and any(D):
        if any(D[5:]) or info.distortion_model not in ("plumb_bob", "rational_polynomial", ""):
            raise InputError(
                f"{location}: the lens model {info.distortion_model} with {len(D)} coefficients is "
                "not supported; use the rectified images (image_rect), or give --camera FILE"
            )
        k1, k2, p1, p2, k3 = [*D, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
        distortion = (k1, k2, p1, p2, k3)
    return CameraModel(int(info.width), int(info.height), (fx, fy, cx, cy), distortion)


def _values(info: Any, name: str) -> list[float]:
    """Return a matrix of the message as a list. ROS 1 has upper-case names."""
    matrix = getattr(info, name, None)
    return [float(value) for value in (getattr(info, name.upper()) if matrix is None else matrix)]
