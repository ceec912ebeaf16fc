"""Recordings of any format: their pairs of images, and gravity."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.calibration import CameraCalibration, DepthCameraCalibration
from drivers.camera import MAX_ACCELEROMETER_READINGS, MAX_PAIR_SKEW_US, AccelerometerReading
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, Vector, is_gravity
from drivers.recording.image_decoding import (
    JPEG_START,
    PNG_SIGNATURE,
    BgrImage,
    DepthImage,
    UnreadableFrameError,
    decode_color,
    decode_depth,
    decode_image,
    reduce_to_8_bits,
    stored_color,
    stored_depth,
)

__all__ = [  # from `image_decoding`
    "JPEG_START",
    "PNG_SIGNATURE",
    "BgrImage",
    "DepthImage",
    "UnreadableFrameError",
    "decode_color",
    "decode_depth",
    "decode_image",
    "reduce_to_8_bits",
    "stored_color",
    "stored_depth",
]

# Stamps are kept as decimals: 17 digits of seconds do not fit a float, and differences are exact.
# The precision holds the sum of any two printed floats.
EXACT_CONTEXT = Context(prec=100)
AVERAGING_WINDOW_S = 1.0
ImageSize = tuple[int, int]  # (width, height)
ImageTopics = tuple[str, str]  # of color and depth, in a bag


@dataclass(frozen=True)
class RecordedImage(ABC):
    """One image of a recording, not read yet.

    Attributes:
        stamp: Stamp in seconds.
        file: The file that holds it.
        location: Where it is listed, for error messages.
    """

    stamp: Decimal
    file: Path
    location: str

    @property
    def stamp_s(self) -> float:
        """The stamp as a float."""
        return float(self.stamp)

    @property
    def log_stamp(self) -> Decimal:
        """When the image was recorded, s: its stamp, where that is not known."""
        return self.stamp

    @property
    def name(self) -> str:
        """The image's name in error messages."""
        return str(self.file)

    @abstractmethod
    def read_color(self) -> BgrImage:
        """Read (height, width, 3) BGR uint8. Raises UnreadableFrameError."""

    @abstractmethod
    def read_depth(self) -> DepthImage:
        """Read (height, width) uint16. Raises UnreadableFrameError."""

    @abstractmethod
    def read_stored_color(self) -> bytes | BgrImage:
        """Read a PNG or JPEG as it is stored; other images as `read_color`."""

    @abstractmethod
    def read_stored_depth(self) -> bytes | DepthImage:
        """Read a PNG as it is stored; other images as `read_depth`."""


@dataclass(frozen=True)
class FramePair:
    """The color and the depth image of one frame."""

    color: RecordedImage
    depth: RecordedImage

    @property
    def skew_s(self) -> float:
        """Stamp of depth minus stamp of color."""
        return float(EXACT_CONTEXT.subtract(self.depth.stamp, self.color.stamp))

    def load(self, size: ImageSize, depth_size: ImageSize) -> tuple[BgrImage, DepthImage]:
        """Read both images.

        Args:
            size: (width, height) of the camera.
            depth_size: (width, height) of the depth image.

        Returns:
            Color (height, width, 3) BGR uint8 and depth (height, width) uint16.

        Raises:
            UnreadableFrameError: An image cannot be read or has the wrong size.
        """
        color, depth = self.color.read_color(), self.depth.read_depth()
        if size == depth_size and color.shape[:2] != depth.shape:
            raise UnreadableFrameError(
                f"{self.color.name}: color is {_size_text(color)} but depth ({self.depth.name}) is "
                f"{_size_text(depth)}; register the depth to the color image"
            )
        for image, expected, of in ((color, size, self.color), (depth, depth_size, self.depth)):
            if image.shape[:2] != expected[::-1]:
                raise UnreadableFrameError(
                    f"{of.name}: the image is {_size_text(image)} but the camera is "
                    f"{expected[0]}x{expected[1]}; give the camera file of these images"
                )
        return color, depth


def _size_text(image: NDArray[Any]) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"


@dataclass(frozen=True)
class RecordedFrames:
    """The frames of a recording, and the number of images without a partner."""

    pairs: list[FramePair]
    unpaired: int = 0

    @property
    def stamps_s(self) -> Array:
        """(N,) stamps of the frames."""
        return np.array([pair.color.stamp_s for pair in self.pairs])


StampsUs = NDArray[np.int64]


def pair_nearest(color_us: StampsUs, depth_us: StampsUs, max_skew_us: int) -> list[tuple[int, int]]:
    """Pair two rising lists of stamps one to one.

    Greedy over all candidates, closest first, as in the TUM RGB-D benchmark's ``associate.py``;
    of two equally close ones the earlier is taken first. Only stamps within `max_skew_us` are
    candidates, so time and memory are linear in the length of the lists.

    Args:
        color_us: (N,) stamps of the color images, microseconds.
        depth_us: (M,) stamps of the depth images, microseconds.
        max_skew_us: Largest difference of two paired stamps, microseconds.

    Returns:
        Pairs (index in color, index in depth), in order of time.
    """
    first = np.searchsorted(depth_us, color_us - max_skew_us, side="left")
    last = np.searchsorted(depth_us, color_us + max_skew_us, side="right")
    candidates = sorted(
        (abs(int(color_us[i] - depth_us[j])), i, j)
        for i in range(len(color_us))
        for j in range(first[i], last[i])
    )
    depth_of_color: dict[int, int] = {}
    paired_depths: set[int] = set()
    for _, i, j in candidates:
        if i not in depth_of_color and j not in paired_depths:
            depth_of_color[i] = j
            paired_depths.add(j)
    return sorted(depth_of_color.items())


def pair_images(color: Sequence[RecordedImage], depth: Sequence[RecordedImage]) -> RecordedFrames:
    """Pair images by the nearest stamps, at most `MAX_PAIR_SKEW_US` apart."""
    indices = pair_nearest(stamps_us(color), stamps_us(depth), MAX_PAIR_SKEW_US)
    pairs = [FramePair(color[i], depth[j]) for i, j in indices]
    return RecordedFrames(pairs, len(color) + len(depth) - 2 * len(pairs))


def stamps_us(images: Sequence[RecordedImage]) -> StampsUs:
    """Return the (N,) stamps of images, rounded to microseconds."""
    return np.array([int(image.stamp.scaleb(6).to_integral_value()) for image in images], np.int64)


@dataclass(frozen=True)
class AccelerometerSeries:
    """Readings of an accelerometer: (N, 3) m/s^2 in camera axes, at rising stamps (N,)."""

    stamps_s: Array
    acceleration_m_s2: Array

    def gravity_at(self, stamp_s: float) -> Vector | None:
        """Return gravity by the reading with this stamp, else by the mean of the second before.

        Readings of other lengths than gravity's are left out; None without any. This program's
        recordings have one reading per frame, which is already smoothed.
        """
        stamps_s, gravity_m_s2 = self._gravity
        end = int(np.searchsorted(stamps_s, stamp_s, side="right"))
        begin = int(np.searchsorted(stamps_s, stamp_s - AVERAGING_WINDOW_S))
        if end == begin:
            return None
        if stamps_s[end - 1] == stamp_s:
            begin = end - 1
        x, y, z = gravity_m_s2[begin:end].mean(axis=0).tolist()
        return (x, y, z)

    def newest_at(self, stamp_s: float) -> tuple[AccelerometerReading, ...]:
        """Return the newest readings up to a frame's stamp, see `RgbdFrame.accelerometer`."""
        end = int(np.searchsorted(self.stamps_s, stamp_s, side="right"))
        rows = slice(max(0, end - MAX_ACCELEROMETER_READINGS), end)
        numbers = zip(
            self.stamps_s[rows].tolist(), self.acceleration_m_s2[rows].tolist(), strict=True
        )
        return tuple(AccelerometerReading(stamp_s, (x, y, z)) for stamp_s, (x, y, z) in numbers)

    @property
    def gravity_count(self) -> int:
        """The number of readings that gravity alone explains."""
        return len(self._gravity[0])

    @cached_property
    def _gravity(self) -> tuple[Array, Array]:
        """Stamps and gravity of the readings that gravity alone explains."""
        gravity_m_s2 = -self.acceleration_m_s2
        kept = np.array([is_gravity((x, y, z)) for x, y, z in gravity_m_s2.tolist()], bool)
        return self.stamps_s[kept], gravity_m_s2[kept]


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
        path: The folder or file.
        frames: The frames, not read yet.
        calibration: The camera.
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
