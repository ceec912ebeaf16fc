"""What a recording is written to: a folder, an MCAP file or a bag."""

from abc import ABC, abstractmethod
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple

from drivers.calibration import CameraCalibration
from drivers.core.geometry import Array, Vector
from drivers.recording.frame_encoding import FrameStamps
from drivers.recording.image_decoding import BgrImage, DepthImage
from drivers.recording.image_encoding import ColorFormat


class StoredFrame(NamedTuple):
    """A frame with its images as they are stored.

    Attributes:
        stamps: Exact stamps of both images, s.
        color: A file (PNG, JPEG), or the (H, W, 3) image.
        depth: A file (PNG), or the (H, W) image in units of the camera file.
        logged: Log times of both images, s; None for the stamps.
    """

    stamps: FrameStamps
    color: bytes | BgrImage
    depth: bytes | DepthImage
    logged: FrameStamps | None = None

    @property
    def log_times(self) -> FrameStamps:
        """Log times of both images, s."""
        return self.logged or self.stamps


class RecordingSink(ABC):
    """Takes the contents of a recording, in order of time. All methods raise OSError."""

    @abstractmethod
    def write_frame(self, frame: StoredFrame) -> None:
        """Write the images of a frame: files with the bytes that they have, or raw.

        Raises:
            OSError: Writing fails.
            InputError: The format has no such stamps.
            UnreadableFrameError: A file that must be converted cannot be decoded.
        """

    @abstractmethod
    def write_reading(self, stamp: Decimal, acceleration_m_s2: Vector) -> None:
        """Write a reading of the accelerometer, in camera axes."""

    @abstractmethod
    def write_gravity(self, stamp: Decimal, gravity_m_s2: Vector) -> None:
        """Write the gravity of a frame, in camera axes."""

    @abstractmethod
    def write_odometry(self, stamp: Decimal, message: bytes) -> None:
        """Write a message of the base's odometry, CDR ``nav_msgs/msg/Odometry``."""

    @abstractmethod
    def write_true_pose(self, stamp: Decimal, T_world_camera: Array) -> None:
        """Write a true pose (4x4) of the camera."""


class RecordingFile(ABC):
    """A new file or folder of one recording. It holds whole frames after a crash or a full disk.

    Attributes:
        written: Number of frames that it holds.
        color_format: File format of the color images; None to store them raw.
        depth_format: File format of the depth images; None to store them raw.
        min_free_bytes: Left free on the disk.
        max_pending_frames: Frames that may wait for a slow disk.
    """

    path: Path
    written: int = 0
    color_format: ColorFormat | None = None
    depth_format: ColorFormat | None = None
    min_free_bytes: int = 0
    max_pending_frames: int = 30

    @abstractmethod
    def begin(self, calibration: CameraCalibration, start: Decimal) -> RecordingSink:
        """Write what belongs to the whole recording; raises OSError.

        Args:
            start: Stamp of the first image, s.
        """

    @abstractmethod
    def flush(self) -> None:
        """Hand all that was written to the system, so that a crash does not lose it.

        Raises:
            OSError: Writing fails, or the file is no longer at its path.
        """

    @abstractmethod
    def cut(self) -> None:
        """Go back to the last whole part, after an OSError; nothing is written any more."""

    @abstractmethod
    def complete(self) -> None:
        """Write the end. Raises OSError."""

    @abstractmethod
    def close(self) -> None:
        """Release the file, and remove it if there is nothing in it. Safe to call twice."""

    @property
    @abstractmethod
    def remark(self) -> str:
        """What became of the frames so far, for an error message; "" without frames."""
