"""How a source's raw images become a frame's: lens, registration, unit, and who says so.

The rule of registration, for everything that libOpenNI2 opens:

- A camera file with a `[depth]` table says that depth is a camera of its own: a device is told not
  to register, and registration happens here.
- A camera file without one says that a recording's depth is registered. A device says so itself.
- Without a camera file a device must register, and say that it does. A recording is refused: the
  format has no place for it, and depth taken for registered when it is not bends every pose.
"""

from dataclasses import dataclass
from enum import Enum
from math import tan
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import NO_DISTORTION, CameraCalibration, read_calibration
from drivers.camera import PinholeCamera
from drivers.core.errors import InputError
from drivers.rectify import SoftwareRegistration, Undistorter, make_undistorter

# The usual values of these sensors, for an image 640 pixels wide.
DEFAULT_FOCAL_PX, DEFAULT_WIDTH_PX = 525.0, 640
# A camera file corrects a sensor's scale by per cent; beyond this it is one for another unit.
MAX_SCALE_CORRECTION = 1.25

Size = tuple[int, int]


class DepthRegistration(Enum):
    """Whether the depth that a source delivers is registered to its color image."""

    YES = "yes"
    NO = "no"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class SourceProperties:
    """What a device or a recording says of its images; sizes are (width, height)."""

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
    """The camera file that the user gave, if any."""

    path: Path | None
    calibration: CameraCalibration | None

    @classmethod
    def read(cls, path: Path | None) -> "CalibrationFile":
        """Read it. Raises InputError."""
        return cls(path, None if path is None else read_calibration(path))

    @property
    def has_depth_camera(self) -> bool:
        """Whether depth is to be registered here."""
        return self.calibration is not None and self.calibration.depth is not None


class DepthRectifier(Protocol):
    """Makes depth as delivered the depth of the undistorted color camera."""

    def __call__(self, image: NDArray[np.uint16], /) -> NDArray[np.uint16]:
        """(height, width) uint16 in the same unit."""
        ...


@dataclass(frozen=True)
class OpenNI2Rectifier:
    """Makes a frame's images. `intrinsics_source` says where `camera` comes from.

    The timing is the camera file's, see `CameraCalibration`; zero without one.
    """

    camera: PinholeCamera
    depth_factor: float
    intrinsics_source: str
    undistorter: Undistorter
    depth_rectifier: DepthRectifier
    flip_color: bool
    flip_depth: bool
    readout_s: float = 0.0
    depth_offset_s: float = 0.0

    def rectify_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistorted."""
        if self.flip_color:
            image = cv2.flip(image, 1)  # type: ignore[assignment]
        return self.undistorter.undistort_color(image)

    def rectify_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Undistorted and registered."""
        if self.flip_depth:
            image = cv2.flip(image, 1)  # type: ignore[assignment]
        return self.depth_rectifier(image)


def make_rectifier(source: SourceProperties, calibration_file: CalibrationFile) -> OpenNI2Rectifier:
    """Raises InputError where file and source do not fit, or depth cannot be registered."""
    if calibration_file.calibration is None:
        return _make_uncalibrated_rectifier(source)
    _check_calibration(source, calibration_file.calibration, f"camera file {calibration_file.path}")
    camera, depth = calibration_file.calibration.pinhole, calibration_file.calibration.depth
    lens = make_undistorter(camera, calibration_file.calibration.distortion)
    path: DepthRectifier
    if depth is None:
        path, factor = lens.undistort_depth, calibration_file.calibration.depth_factor
    else:
        registration = SoftwareRegistration(
            camera, depth, calibration_file.calibration.depth_factor
        )
        path, factor = registration.register, registration.depth_factor
    return OpenNI2Rectifier(
        camera,
        factor,
        f"camera file {calibration_file.path}",
        lens,
        path,
        source.flip_color,
        source.flip_depth,
        calibration_file.calibration.readout_s,
        calibration_file.calibration.depth_offset_s,
    )


def _make_uncalibrated_rectifier(source: SourceProperties) -> OpenNI2Rectifier:
    if source.registration is not DepthRegistration.YES:
        raise _unregistered_error(source)
    _check_same_size(source)
    camera, told = _source_intrinsics(source)
    lens = make_undistorter(camera, NO_DISTORTION)
    return OpenNI2Rectifier(
        camera,
        source.depth_factor,
        told,
        lens,
        lens.undistort_depth,
        source.flip_color,
        source.flip_depth,
    )


def _source_intrinsics(source: SourceProperties) -> tuple[PinholeCamera, str]:
    """Intrinsics from the field of view that the source tells, else the usual ones."""
    width, height = source.color_size
    centre = ((width - 1) / 2, (height - 1) / 2)
    across, down = source.color_fov_rad
    if 0.1 < across < 3.0 and 0.1 < down < 3.0:
        fx, fy = width / (2 * tan(across / 2)), height / (2 * tan(down / 2))
        return PinholeCamera(width, height, fx, fy, *centre), "factory"
    focal = DEFAULT_FOCAL_PX * width / DEFAULT_WIDTH_PX
    return PinholeCamera(width, height, focal, focal, *centre), "default"


def _check_calibration(source: SourceProperties, calibration: CameraCalibration, name: str) -> None:
    _check_size(source, "color", source.color_size, (calibration.width, calibration.height), name)
    if calibration.depth is not None:
        depth_size = (calibration.depth.width, calibration.depth.height)
        _check_size(source, "depth", source.depth_size, depth_size, f"[depth] of {name}")
        if source.registration is DepthRegistration.YES:
            raise InputError(
                f"{source.name}: registers its depth and cannot be told not to; leave [depth] "
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
            f"{source.depth_factor:g} per metre; set depth_factor = {source.depth_factor:.1f}"
        )


def _check_size(source: SourceProperties, what: str, has: Size, wanted: Size, name: str) -> None:
    if has != wanted:
        raise InputError(
            f"{source.name}: {what} is {has[0]}x{has[1]}, but {name} is for "
            f"{wanted[0]}x{wanted[1]}; give the camera file of these images"
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
            f"{source.name}: does not say whether its depth was registered to color; give a "
            "camera file: without a [depth] table if it was, with one if it was not (kinect-vo "
            "calibrate --depth)"
        )
    return InputError(
        f"{source.name}: does not register its depth to color; give a camera file with a [depth] "
        "table (kinect-vo calibrate --depth)"
    )
