"""From a frame to the bytes of its image files and the text of its stamps."""

from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from typing import Any, Self

import cv2
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.gravity import Vector
from drivers.tum.lists import EXACT

MICROSECOND = Decimal("1e-6")


class ColourFormat(StrEnum):
    """How colour images are stored; depth is always PNG."""

    PNG = "png"  # exact
    JPEG = "jpg"  # far smaller and quicker, but not exact


@dataclass(frozen=True)
class FrameStamps:
    """When the two images of a frame were taken, exactly, in seconds."""

    colour: Decimal
    depth: Decimal

    @classmethod
    def of(cls, frame: RgbdFrame) -> Self:
        """From the shortest decimals that are the frame's floats: sums of them are exact."""
        colour = Decimal(repr(float(frame.stamp_s)))
        return cls(colour, EXACT.add(colour, Decimal(repr(float(frame.skew_s)))))

    def follow(self, other: "FrameStamps") -> bool:
        """True if both come later than those of `other`, to the microsecond."""
        return microseconds(self.colour) > microseconds(other.colour) and (
            microseconds(self.depth) > microseconds(other.depth)
        )


BEFORE_ALL = FrameStamps(Decimal("-Infinity"), Decimal("-Infinity"))


@dataclass(frozen=True)
class EncodedFrame:
    """A frame as it goes to disk."""

    stamps: FrameStamps
    colour: bytes
    depth: bytes
    gravity_m_s2: Vector | None


def encode(frame: RgbdFrame, stamps: FrameStamps, colour: ColourFormat) -> EncodedFrame:
    """Make the image files of a frame."""
    depth = _image_file(frame.depth_raw, ColourFormat.PNG)
    return EncodedFrame(stamps, _image_file(frame.colour_bgr, colour), depth, frame.gravity_m_s2)


def microseconds(stamp: Decimal) -> Decimal:
    """`stamp` rounded to a microsecond: what file names show."""
    return stamp.quantize(MICROSECOND) if stamp.is_finite() else stamp


def exact(stamp: Decimal) -> str:
    """To the microsecond as is usual, with more digits only where there are more."""
    short = microseconds(stamp)
    return f"{short if short == stamp else stamp:f}"


def _image_file(image: NDArray[Any], kind: ColourFormat) -> bytes:
    # OpenCV's own PNG settings (run lengths, horizontal differences) beat level 1 in time and size.
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if kind is ColourFormat.JPEG else []
    return cv2.imencode(f".{kind}", image, options)[1].tobytes()
