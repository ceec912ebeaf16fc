"""Rectification: from a source's images to a frame's, undistorted and with registered depth.

The rule of registration, for devices and recordings:

- A camera file with a `[depth]` table describes a separate depth camera: registration by the
  device is switched off, and the driver registers depth.
- A camera file without that table declares a recording's depth as registered. A device reports
  itself whether it registers.
- Without a camera file a device must report that it registers. A recording is rejected, because
  its format does not store this, and unregistered depth taken for registered distorts every pose.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.calibration import (
    MILLIMETERS_PER_METER,
    NO_DISTORTION,
    CameraCalibration,
    DepthCameraCalibration,
    kinect_timing,
    read_calibration,
)
from drivers.camera import MAX_DEPTH_VALUE, PinholeCamera, TimingPrior
from drivers.core import InputError
from drivers.core.geometry import Array

# A camera file corrects the scale by a few percent; beyond this it is for another unit.
MAX_SCALE_CORRECTION = 1.25

Size = tuple[int, int]
Timing = tuple[float, TimingPrior | None]


class Undistorter:
    """Converts a camera's images to those of the pinhole camera with the same intrinsics.

    Args:
        distortion: k1 k2 p1 p2 k3; all zeros return images unchanged.
    """

    def __init__(self, camera: PinholeCamera, distortion: Sequence[float]) -> None:
        self._is_needed = any(distortion)
        if not self._is_needed:
            return
        import cv2  # here, because a driver that changes no image needs no OpenCV

        coefficients = np.array(distortion, dtype=np.float64)
        size = (camera.width, camera.height)
        columns, rows = cv2.initUndistortRectifyMap(
            camera.K, coefficients, np.eye(3), camera.K, size, cv2.CV_32FC1
        )
        # Fixed-point maps are several times faster than float, and bit-identical on all machines.
        self._bilinear_maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2)
        self._nearest_maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2, nninterpolation=True)

    def undistort_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort (height, width, 3) uint8 bilinearly; black outside the original image."""
        if not self._is_needed:
            return image
        import cv2

        return cv2.remap(image, *self._bilinear_maps, cv2.INTER_LINEAR)  # type: ignore[return-value]

    def undistort_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Undistort (height, width) uint16 without interpolation; 0 outside the original image."""
        if not self._is_needed:
            return image
        import cv2

        return cv2.remap(image, *self._nearest_maps, cv2.INTER_NEAREST)  # type: ignore[return-value]


_ZERO_DISTORTION = np.zeros(5)


class SoftwareRegistration:
    """Registers depth to the color camera; of several readings for a pixel the nearest is kept.

    Values stay in the sensor's own unit. The attribute `depth_factor` is the value per true meter,
    so it includes the calibration's scale. Pixels without a reading (occluded, or outside the
    depth camera's view) are 0. If the color camera's pixels are finer, a reading fills all that
    it covers.

    Args:
        depth_factor: The sensor's value per meter.

    Raises:
        InputError: The two cameras do not look in the same direction.
    """

    def __init__(
        self, color: PinholeCamera, depth: DepthCameraCalibration, depth_factor: float
    ) -> None:
        self.depth_factor = depth_factor / depth.scale
        self._undistorter = Undistorter(depth.pinhole, depth.distortion)
        self._depth_K, self._color_K = depth.pinhole.K, color.K
        # OpenCV 5.0 writes out of bounds if the result is smaller than the depth image.
        self._output_size = (max(color.width, depth.width), max(color.height, depth.height))
        self._rows, self._columns = slice(color.height), slice(color.width)
        self._needs_dilation = color.fx > depth.fx or color.fy > depth.fy
        self._T_color_depth = depth.T_color_depth.matrix
        # OpenCV takes the values for millimeters, so the translation is in the same unit.
        self._T_color_depth[:3, 3] *= self.depth_factor / MILLIMETERS_PER_METER
        self._min_value, self._max_value = _usable_range(depth.pinhole, self._T_color_depth)

    def register(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Map the depth camera's (height, width) uint16 image to the color camera's; 0 = none."""
        import cv2

        undistorted = self._undistorter.undistort_depth(image)
        is_usable = cv2.inRange(undistorted, self._min_value, self._max_value)
        usable = cv2.bitwise_and(undistorted, undistorted, mask=is_usable)
        registered: NDArray[np.uint16] = cv2.registerDepth(
            self._depth_K,
            self._color_K,
            _ZERO_DISTORTION,
            self._T_color_depth,
            usable,
            self._output_size,
            depthDilation=self._needs_dilation,
        )  # type: ignore[assignment]
        return np.ascontiguousarray(registered[self._rows, self._columns])


def _usable_range(depth: PinholeCamera, T_color_depth: Array) -> tuple[int, int]:
    """Return the smallest and largest reading that is in front of the color camera and in 16 bits.

    OpenCV lets other readings wrap around.
    """
    u, v = np.meshgrid((0, depth.width - 1), (0, depth.height - 1))
    rays = np.stack([(u - depth.cx) / depth.fx, (v - depth.cy) / depth.fy, np.ones_like(u)])
    # Growth of the depth in the color camera per unit read; its extremes are at the corners.
    growth = np.tensordot(T_color_depth[2, :3], rays, axes=1)
    if growth.min() <= 0.1:
        raise InputError(
            "camera file: [depth] T_color_depth turns the depth camera away from the color "
            "camera; it must map depth camera coordinates to the color camera's"
        )
    offset = T_color_depth[2, 3] * MILLIMETERS_PER_METER
    nearest = max(0, math.floor(-offset / growth.min())) + 1
    max_value = MAX_DEPTH_VALUE - 1  # above is no reading
    farthest = math.floor((max_value - offset) / growth.max())
    return nearest, min(max_value, farthest)


class Rectifier:
    """Converts the images of one pair of cameras to those of a frame.

    Attributes:
        camera: The undistorted color camera, to which depth is registered.
        depth_factor: Value of the rectified depth per meter.

    Args:
        calibration: The color camera.
        depth_camera: The depth camera; None if depth is registered to color already.
        timing: Readout in seconds, and how well it is known.
        intrinsics_source: The origin of the intrinsics.

    Raises:
        InputError: The depth camera does not look where the color camera does.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        depth_camera: DepthCameraCalibration | None,
        timing: Timing,
        intrinsics_source: str,
    ) -> None:
        self.camera = calibration.pinhole
        self.intrinsics_source = intrinsics_source
        self.readout_s, self.timing_prior = timing
        self.depth_offset_s = calibration.depth_offset_s
        undistorter = Undistorter(self.camera, calibration.distortion)
        # (height, width, 3) uint8 BGR, and (height, width) uint16 with 0 = no reading.
        self.rectify_color = undistorter.undistort_color
        if depth_camera is None:
            self.rectify_depth = undistorter.undistort_depth
            self.depth_factor = calibration.depth_factor
        else:
            registration = SoftwareRegistration(self.camera, depth_camera, calibration.depth_factor)
            self.rectify_depth = registration.register
            self.depth_factor = registration.depth_factor


class DepthRegistration(Enum):
    """Whether a source delivers depth that is registered to its color image."""

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class SourceProperties:
    """What a device or an `.oni` recording tells of its images.

    Attributes:
        name: The source in messages.
        camera: The color camera, for a source without a camera file.
        depth_size: (width, height) of the depth images.
        depth_factor: Value of the depth images per meter.
        registration: Whether depth is registered, with what the camera file asks for set.
    """

    name: str
    camera: PinholeCamera
    camera_source: str
    depth_size: Size
    depth_factor: float
    registration: DepthRegistration

    @property
    def color_size(self) -> Size:
        """(width, height) of the color images."""
        return self.camera.width, self.camera.height


def factory_camera(size: Size, fx: float, fy: float) -> PinholeCamera:
    """Make the camera of a sensor of which only the focal lengths are known, in pixels."""
    return PinholeCamera(*size, fx, fy, (size[0] - 1) / 2, (size[1] - 1) / 2)


@dataclass(frozen=True)
class CalibrationFile:
    """The user's camera file, if there is one."""

    path: Path | None
    calibration: CameraCalibration | None

    @classmethod
    def read(cls, path: Path | None) -> "CalibrationFile":
        """Read a camera file. Raises InputError."""
        return cls(path, None if path is None else read_calibration(path))

    @property
    def has_depth_camera(self) -> bool:
        """Whether the driver has to register depth."""
        return self.calibration is not None and self.calibration.depth is not None


def make_rectifier(source: SourceProperties, calibration_file: CalibrationFile) -> Rectifier:
    """Make the rectifier of a source.

    The timing is that of the camera file, see `CameraCalibration`, or the usual one of a Kinect.

    Raises:
        InputError: The camera file does not fit the source, or depth cannot be registered.
    """
    calibration, name = calibration_file.calibration, f"camera file {calibration_file.path}"
    if calibration is not None:
        _check_calibration(source, calibration, name)
    else:
        if source.registration is not DepthRegistration.YES:
            raise _unregistered_error(source)
        _check_same_size(source)
        camera, name = source.camera, source.camera_source
        calibration = CameraCalibration(
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            NO_DISTORTION,
            source.depth_factor,
        )
    return Rectifier(calibration, calibration.depth, kinect_timing(calibration), name)


def _check_calibration(source: SourceProperties, calibration: CameraCalibration, name: str) -> None:
    _check_size(source, "color", source.color_size, (calibration.width, calibration.height), name)
    if calibration.depth is not None:
        depth_size = (calibration.depth.width, calibration.depth.height)
        _check_size(source, "depth", source.depth_size, depth_size, f"[depth] of {name}")
        if source.registration is DepthRegistration.YES:
            raise InputError(
                f"{source.name}: registers its depth and cannot switch that off; leave [depth] "
                f"out of {name}"
            )
    else:
        if source.registration is DepthRegistration.NO:
            raise _unregistered_error(source)
        _check_same_size(source)
    correction = calibration.depth_factor / source.depth_factor
    if not 1 / MAX_SCALE_CORRECTION < correction < MAX_SCALE_CORRECTION:
        raise InputError(
            f"{name}: depth_factor is {calibration.depth_factor:g}, but {source.name} delivers "
            f"{source.depth_factor:g} per meter; set depth_factor = {source.depth_factor:.1f}"
        )


def _check_size(
    source: SourceProperties, stream: str, size: Size, expected: Size, name: str
) -> None:
    if size != expected:
        raise InputError(
            f"{source.name}: {stream} is {size[0]}x{size[1]}, but {name} is for "
            f"{expected[0]}x{expected[1]}; give the camera file of these images"
        )


def _check_same_size(source: SourceProperties) -> None:
    if source.color_size != source.depth_size:
        (w, h), (depth_w, depth_h) = source.color_size, source.depth_size
        raise InputError(
            f"{source.name}: color is {w}x{h} but depth is {depth_w}x{depth_h}, so it cannot be "
            "registered; give a camera file with a [depth] table (kinect-vo calibrate --depth)"
        )


def _unregistered_error(source: SourceProperties) -> InputError:
    if source.registration is DepthRegistration.UNKNOWN:
        return InputError(
            f"{source.name}: does not store whether its depth was registered to color; give a "
            "camera file: without a [depth] table if it was, with one if it was not (kinect-vo "
            "calibrate --depth)"
        )
    return InputError(
        f"{source.name}: does not register its depth to color; give a camera file with a [depth] "
        "table (kinect-vo calibrate --depth)"
    )
