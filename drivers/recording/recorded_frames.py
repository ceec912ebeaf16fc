"""Frames of a recording: pairs of images that are not read yet."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from decimal import Context, Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.recording.image_decoding import BgrImage, DepthImage, UnreadableFrameError

# Stamps are kept as decimals: 17 digits of seconds do not fit a float, and differences are exact.
# The precision holds the sum of any two printed floats.
EXACT_CONTEXT = Context(prec=100)
ImageSize = tuple[int, int]  # (width, height)


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
