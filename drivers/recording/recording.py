"""A recording of any format that is checked and can be replayed."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.calibration import CameraCalibration, DepthCameraCalibration
from drivers.core import InputError
from drivers.core.geometry import Trajectory, Vector
from drivers.recording.accelerometer import AccelerometerSeries
from drivers.recording.recorded_frames import ImageSize, RecordedFrames

ImageTopics = tuple[str, str]  # of color and depth, in a bag


def _nothing_to_close() -> None:
    """Close nothing: the recording's images are files of their own."""


@dataclass(frozen=True)
class BagTopicsInUse:
    """The topics of a bag that a `Recording` has the contents of, and the camera's frame.

    Attributes:
        frames: Topics of images, cameras, and of what belongs to each frame.
        series: Topics of the readings, gravity and true poses.
        camera_frame: The name of the color camera's frame.
    """

    frames: frozenset[str]
    series: frozenset[str]
    camera_frame: str


@dataclass(frozen=True)
class Recording:
    """A checked recording that can be replayed.

    Attributes:
        frames: The frames, not read yet.
        ground_truth: True poses of the color camera; None without.
        accelerometer: Readings of the accelerometer.
        gravity: Smoothed gravity with each frame, if it is recorded beside the readings.
        depth_camera: The depth camera, if depth is not registered to color.
        depth_enlargement: N if each pixel of registered depth covers N x N of color.
        intrinsics_source: The camera file or the topic that the intrinsics are from.
        depth_unit_source: The same for the depth factor; "" if the unit of depth is certain.
        summary: What was found in a file that does not say which images to use; "" if it is clear.
        warning: What is wrong with its clock; "" if nothing is.
        topics: The topics of a bag; None for a folder.
        close: Closes the file that the images are read from. Reading opens it again.
    """

    path: Path
    frames: RecordedFrames
    calibration: CameraCalibration
    ground_truth: Trajectory | None
    accelerometer: AccelerometerSeries
    gravity: AccelerometerSeries | None = None
    depth_camera: DepthCameraCalibration | None = None
    depth_enlargement: int = 1
    intrinsics_source: str = ""
    depth_unit_source: str = ""
    summary: str = ""
    warning: str = ""
    topics: BagTopicsInUse | None = None
    close: Callable[[], None] = _nothing_to_close

    @property
    def name(self) -> str:
        """The recording's name in messages."""
        return str(self.path)

    def gravity_at(self, stamp_s: float) -> Vector | None:
        """Return gravity in camera axes at a frame's stamp, if it is known."""
        return (self.gravity or self.accelerometer).gravity_at(stamp_s)

    def require_rising_stamps(self, consequence: str) -> None:
        """Raise InputError, with the consequence, if the clock was set back."""
        if (np.diff(self.frames.stamps_s) < 0).any():
            raise InputError(f"{self.path}: its clock was set back, {consequence}")

    @property
    def image_size(self) -> ImageSize:
        """(width, height) of the color images."""
        return self.calibration.width, self.calibration.height

    @property
    def depth_size(self) -> ImageSize:
        """(width, height) of the depth images."""
        if self.depth_camera is not None:
            return self.depth_camera.width, self.depth_camera.height
        width, height = self.image_size
        return width // self.depth_enlargement, height // self.depth_enlargement
