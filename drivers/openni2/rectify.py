"""Undistortion and registration of a source's raw images.

The rule of registration, for devices and recordings:

- A camera file with a `[depth]` table describes a separate depth camera: registration by the
  device is switched off, and the driver registers depth.
- A camera file without that table declares a recording's depth as registered. A device reports
  itself whether it registers.
- Without a camera file a device must report that it registers. A recording is rejected, because
  its format does not store this, and unregistered depth taken for registered distorts every pose.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import tan
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import (
    NO_DISTORTION,
    CameraCalibration,
    SoftwareRegistration,
    Undistorter,
    kinect_timing,
    read_calibration,
)
from drivers.camera import PinholeCamera, TimingPrior
from drivers.core import InputError

# The usual values of these sensors, for an image 640 pixels wide.
DEFAULT_FOCAL_PX, DEFAULT_WIDTH_PX = 525.0, 640
# A camera file corrects the scale by a few percent; beyond this it is for another unit.
MAX_SCALE_CORRECTION = 1.25

Size = tuple[int, int]


class DepthRegistration(Enum):
    """Whether a source delivers depth that is registered to its color image."""

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class SourceProperties:
    """The properties of the images of a device or a recording; sizes are (width, height)."""

    name: str
    color_size: Size
    depth_size: Size
    color_fov_rad: tuple[float, float]
    depth_factor: float
    registration: DepthRegistration
    flip_color: bool = False
    flip_depth: bool = False


@dataclass(frozen=True)
class CalibrationFile:
    """The user's camera file, if there is one."""

    path: Path | None
    calibration: CameraCalibration | None

    @classmethod
    def read(cls, path: Path | None) -> "CalibrationFile":
        """Read a camera file.

        Raises:
            InputError: If it is not valid.
        """
        return cls(path, None if path is None else read_calibration(path))

    @property
    def has_depth_camera(self) -> bool:
        """Whether the driver has to register depth."""
        return self.calibration is not None and self.calibration.depth is not None


# Maps delivered depth, (height, width) uint16, to the undistorted color camera in the same unit.
DepthRectifier = Callable[[NDArray[np.uint16]], NDArray[np.uint16]]


@dataclass(frozen=True)
class OpenNI2Rectifier:
    """Converts delivered images to a frame's images.

    The timing is that of the camera file, see `CameraCalibration`, or the usual one of a Kinect.
    """

    camera: PinholeCamera
    depth_factor: float
    intrinsics_source: str
    undistorter: Undistorter
    depth_rectifier: DepthRectifier
    flip_color: bool
    flip_depth: bool
    readout_s: float
    timing_prior: TimingPrior | None
    depth_offset_s: float = 0.0

    def rectify_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort a color image (height, width, 3) uint8."""
        if self.flip_color:
            image = cv2.flip(image, 1)  # type: ignore[assignment]
        return self.undistorter.undistort_color(image)

    def rectify_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Undistort and register a depth image (height, width) uint16."""
        if self.flip_depth:
            image = cv2.flip(image, 1)  # type: ignore[assignment]
        return self.depth_rectifier(image)


def make_rectifier(source: SourceProperties, calibration_file: CalibrationFile) -> OpenNI2Rectifier:
    """Make the rectifier of a source.

    Raises:
        InputError: The camera file does not fit the source, or depth cannot be registered.
    """
    calibration = calibration_file.calibration
    if calibration is None:
        return _make_uncalibrated_rectifier(source)
    file_name = f"camera file {calibration_file.path}"
    _check_calibration(source, calibration, file_name)
    camera, depth = calibration.pinhole, calibration.depth
    undistorter = Undistorter(camera, calibration.distortion)
    depth_rectifier: DepthRectifier
    if depth is None:
        depth_rectifier, factor = undistorter.undistort_depth, calibration.depth_factor
    else:
        registration = SoftwareRegistration(camera, depth, calibration.depth_factor)
        depth_rectifier, factor = registration.register, registration.depth_factor
    return OpenNI2Rectifier(
        camera,
        factor,
        file_name,
        undistorter,
        depth_rectifier,
        source.flip_color,
        source.flip_depth,
        *kinect_timing(calibration),
        calibration.depth_offset_s,
    )


def _make_uncalibrated_rectifier(source: SourceProperties) -> OpenNI2Rectifier:
    if source.registration is not DepthRegistration.YES:
        raise _unregistered_error(source)
    _check_same_size(source)
    camera, intrinsics_source = _source_intrinsics(source)
    undistorter = Undistorter(camera, NO_DISTORTION)
    return OpenNI2Rectifier(
        camera,
        source.depth_factor,
        intrinsics_source,
        undistorter,
        undistorter.undistort_depth,
        source.flip_color,
        source.flip_depth,
        *kinect_timing(None),
    )


def _source_intrinsics(source: SourceProperties) -> tuple[PinholeCamera, str]:
    """Return the intrinsics by the source's field of view, else the usual ones, and which."""
    width, height = source.color_size
    center = ((width - 1) / 2, (height - 1) / 2)
    horizontal_rad, vertical_rad = source.color_fov_rad
    if 0.1 < horizontal_rad < 3.0 and 0.1 < vertical_rad < 3.0:
        fx, fy = width / (2 * tan(horizontal_rad / 2)), height / (2 * tan(vertical_rad / 2))
        return PinholeCamera(width, height, fx, fy, *center), "factory"
    focal = DEFAULT_FOCAL_PX * width / DEFAULT_WIDTH_PX
    return PinholeCamera(width, height, focal, focal, *center), "default"


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
