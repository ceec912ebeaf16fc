"""From the Kinect's images to a frame's: calibration, valid depth, registration, mirroring.

A Kinect stores a calibration of its factory, which libfreenect reads. It holds which depths the
Kinect can measure, and the map that registers depth to color. From the map follows the focal length
of the color camera.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

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
from drivers.camera import PinholeCamera
from drivers.core import InputError
from drivers.freenect.bindings import DepthFormat

# libfreenect treats this and larger depths as too far.
MAX_DEPTH_MM = 10_000

# Focal lengths of a Kinect's color and depth camera at 640x480, and how far one may be from them.
USUAL_COLOR_FOCAL_PX, USUAL_DEPTH_FOCAL_PX = 525.0, 575.8
MAX_FOCAL_DEVIATION = 0.05
# Largest distance of the map's center from a straight one: lenses bend it by 0.5 px at most.
MAX_MAP_ERROR_PX = 2.0
# Largest stretch of the map in one direction: both cameras have square pixels.
MAX_MAP_STRETCH = 0.02

MillimeterTable = NDArray[np.uint16]


@dataclass(frozen=True)
class FactoryCalibration:
    """The calibration of one Kinect.

    Attributes:
        depth_focal_px: Focal length of the depth camera at 640x480.
        depth_px: (N, 2) columns and rows of the depth camera around its center.
        color_px: (N, 2) where the color camera sees them, up to a shift that depends on distance.
    """

    depth_focal_px: float
    depth_px: NDArray[np.float64]
    color_px: NDArray[np.float64]

    def color_focal_px(self) -> float:
        """Compute the focal length of the color camera.

        A direction is seen by both cameras, so the map magnifies by the ratio of the focal lengths.
        Its center is used, where lenses distort little.

        Raises:
            ValueError: The calibration is not plausible; the message has the reason.
        """
        _check_focal_px("depth", self.depth_focal_px, USUAL_DEPTH_FOCAL_PX)
        rows = np.column_stack([self.depth_px, np.ones(len(self.depth_px))])
        solution = np.linalg.lstsq(rows, self.color_px, rcond=None)[0]
        error_px = float(np.abs(rows @ solution - self.color_px).max())
        if not error_px <= MAX_MAP_ERROR_PX:
            raise ValueError(f"its registration is {error_px:.1f} px off a straight map")
        smallest, largest = np.linalg.svd(solution[:2], compute_uv=False)[::-1].tolist()
        focal_px = self.depth_focal_px * math.sqrt(smallest * largest)
        _check_focal_px("color", focal_px, USUAL_COLOR_FOCAL_PX)
        if not largest / smallest <= 1.0 + MAX_MAP_STRETCH:
            raise ValueError(f"its registration stretches by {largest / smallest - 1.0:.1%}")
        return focal_px


def _check_focal_px(camera: str, focal_px: float, usual_px: float) -> None:
    if not abs(focal_px / usual_px - 1.0) <= MAX_FOCAL_DEVIATION:
        raise ValueError(
            f"the focal length of the {camera} camera would be {focal_px:.4g} px, but Kinects have "
            f"{usual_px:g} px ± {MAX_FOCAL_DEVIATION:.0%}"
        )


# Sets invalid values of a depth image, (480, 640) uint16 millimeters, to 0: no reading.
DepthFilter = Callable[[NDArray[np.uint16]], NDArray[np.uint16]]


def find_valid_depths_mm(raw_to_mm: MillimeterTable) -> MillimeterTable:
    """Find the distances that a device can measure in its table of millimeters per raw value.

    The formula of the table has a pole at a raw value of about 1084. Beyond it the table holds
    huge and negative numbers truncated to 16 bits: most exceed 10 m, but some look like distances.
    A distance is valid if only the rising part before the pole holds it.
    """
    table = raw_to_mm.astype(np.int64)
    ends = np.flatnonzero((table >= MAX_DEPTH_MM) | (np.diff(table, prepend=0) < 0))
    end = int(ends[0]) if ends.size else table.size
    return np.setdiff1d(raw_to_mm[:end], raw_to_mm[end:])


def all_depths_to_10_m() -> MillimeterTable:
    """Return all distances below 10 m, for a source without a table."""
    return np.arange(1, MAX_DEPTH_MM, dtype=np.uint16)


class ValidDepthMask:
    """Keeps the distances of a list and sets all others to 0."""

    def __init__(self, valid_mm: MillimeterTable) -> None:
        self._table = np.zeros(1 << 16, dtype=np.uint16)
        self._table[valid_mm] = valid_mm

    def __call__(self, depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        return cv2.LUT(depth_mm, self._table)  # type: ignore[return-value]


Pixel = TypeVar("Pixel", np.uint8, np.uint16)

WIDTH, HEIGHT = 640, 480
MILLIMETERS_PER_METER = 1000.0
# A camera file corrects the scale by a few percent; beyond this it is for another unit.
MAX_SCALE_CORRECTION = 1.25


def calibration_of_focal_length(focal_px: float) -> CameraCalibration:
    """Make the calibration of a Kinect whose depth libfreenect registers to its color camera."""
    center_px = ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    return CameraCalibration(
        WIDTH, HEIGHT, focal_px, focal_px, *center_px, NO_DISTORTION, MILLIMETERS_PER_METER
    )


DEFAULT_CALIBRATION = calibration_of_focal_length(USUAL_COLOR_FOCAL_PX)


@dataclass(frozen=True)
class HardwareRegistration:
    """Registration by libfreenect, to the color camera's distorted image."""

    undistorter: Undistorter
    depth_factor: float
    depth_format = DepthFormat.REGISTERED_MM

    def register(self, depth_mm: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Map registered depth (480, 640) uint16 to the undistorted color image."""
        return self.undistorter.undistort_depth(depth_mm)


class KinectSoftwareRegistration(SoftwareRegistration):
    """Registration of unregistered depth by the `[depth]` table of the camera file."""

    depth_format = DepthFormat.MM


class KinectRectifier:
    """Converts the Kinect's images to undistorted color and registered depth.

    The finished images are mirrored, because libfreenect's registration needs unmirrored depth.

    Args:
        camera_file: Camera file; None for the values of the factory, or the usual ones.
        is_mirrored: Whether to swap left and right.
        factory_focal_px: Focal length of the color camera by the factory; None if not known.

    Raises:
        InputError: The camera file does not fit the Kinect.
    """

    def __init__(
        self, camera_file: Path | None, is_mirrored: bool, factory_focal_px: float | None = None
    ) -> None:
        calibration, self.intrinsics_source = _find_calibration(camera_file, factory_focal_px)
        _check_calibration(calibration, camera_file)
        pinhole = calibration.pinhole
        self._undistorter = Undistorter(pinhole, calibration.distortion)
        self._registration = _make_registration(calibration, self._undistorter)
        self._is_mirrored = is_mirrored
        self.has_camera_file = camera_file is not None
        self.camera = _mirror_intrinsics(pinhole) if is_mirrored else pinhole
        self.depth_format = self._registration.depth_format
        self.depth_factor = self._registration.depth_factor
        self.readout_s, self.timing_prior = kinect_timing(calibration)
        self.depth_offset_s = calibration.depth_offset_s

    def with_factory_focal_length(self, focal_px: float | None) -> "KinectRectifier":
        """Return the rectifier of another Kinect, of which no camera file tells."""
        return KinectRectifier(None, self._is_mirrored, focal_px)

    def rectify_color(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Convert an image to (480, 640, 3) uint8 BGR of the pinhole `camera`, as a copy."""
        bgr: NDArray[np.uint8] = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)  # type: ignore[assignment]
        return self._mirror(self._undistorter.undistort_color(bgr))

    def rectify_depth(
        self, depth_mm: NDArray[np.uint16], depth_filter: DepthFilter
    ) -> NDArray[np.uint16]:
        """Convert depth to (480, 640) uint16 of the same camera, 0 = no reading, as a copy."""
        return self._mirror(self._registration.register(depth_filter(depth_mm)))

    def _mirror(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        return cv2.flip(image, 1) if self._is_mirrored else image  # type: ignore[return-value]


def _find_calibration(
    camera_file: Path | None, factory_focal_px: float | None
) -> tuple[CameraCalibration, str]:
    """Return the best calibration, and its source."""
    if camera_file is not None:
        return read_calibration(camera_file), f"camera file {camera_file}"
    if factory_focal_px is not None:
        return calibration_of_focal_length(factory_focal_px), "factory"
    return DEFAULT_CALIBRATION, "default"


def _make_registration(
    calibration: CameraCalibration, undistorter: Undistorter
) -> HardwareRegistration | KinectSoftwareRegistration:
    if calibration.depth is None:
        return HardwareRegistration(undistorter, calibration.depth_factor)
    return KinectSoftwareRegistration(
        calibration.pinhole, calibration.depth, calibration.depth_factor
    )


def _mirror_intrinsics(camera: PinholeCamera) -> PinholeCamera:
    return replace(camera, cx=camera.width - 1 - camera.cx)


def _check_calibration(calibration: CameraCalibration, path: Path | None) -> None:
    """Raise InputError if the file is for another camera."""
    for prefix, table in (("", calibration), ("[depth] of ", calibration.depth)):
        if table is not None and (table.width, table.height) != (WIDTH, HEIGHT):
            raise InputError(
                f"{path}: {prefix}this file is for {table.width}x{table.height}, but the Kinect's "
                f"images are {WIDTH}x{HEIGHT}; give the camera file of this Kinect"
            )
    correction = calibration.depth_factor / MILLIMETERS_PER_METER
    if not 1 / MAX_SCALE_CORRECTION < correction < MAX_SCALE_CORRECTION:
        raise InputError(
            f"{path}: depth_factor is {calibration.depth_factor:g}, but the Kinect's depth is in "
            f"millimeters; set depth_factor = {MILLIMETERS_PER_METER}"
        )
