"""From the Kinect's images to a frame's: valid depth, registration, undistortion, mirroring."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import (
    NO_DISTORTION,
    CameraCalibration,
    kinect_timing,
    read_calibration,
)
from drivers.camera import PinholeCamera
from drivers.core.errors import InputError
from drivers.freenect import DepthFormat
from drivers.freenect.factory_calibration import USUAL_COLOR_FOCAL_PX, DepthFilter
from drivers.rectify import SoftwareRegistration, Undistorter, make_undistorter

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
        self._undistorter = make_undistorter(pinhole, calibration.distortion)
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
