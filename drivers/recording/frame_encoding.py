"""What recordings store of a frame beside its images: exact stamps and its calibration."""

from dataclasses import dataclass
from decimal import Decimal
from typing import Self

from drivers.calibration import NO_DISTORTION, CameraCalibration
from drivers.camera import RgbdFrame, TimingSource
from drivers.recording.recorded_frames import EXACT_CONTEXT

MICROSECOND = Decimal("1e-6")


@dataclass(frozen=True)
class FrameStamps:
    """The exact stamps of a frame's two images, in seconds."""

    color: Decimal
    depth: Decimal

    @classmethod
    def from_frame(cls, frame: RgbdFrame) -> Self:
        """Convert a frame's stamps by the shortest decimals of its floats, with an exact sum."""
        color = Decimal(repr(float(frame.stamp_s)))
        return cls(color, EXACT_CONTEXT.add(color, Decimal(repr(float(frame.skew_s)))))

    def is_after(self, other: "FrameStamps") -> bool:
        """Whether both stamps are later than those of `other`, to the microsecond."""
        return round_to_microseconds(self.color) > round_to_microseconds(other.color) and (
            round_to_microseconds(self.depth) > round_to_microseconds(other.depth)
        )


EARLIEST_STAMPS = FrameStamps(Decimal("-Infinity"), Decimal("-Infinity"))


def round_to_microseconds(stamp: Decimal) -> Decimal:
    """Round a stamp to a microsecond, as in file names."""
    return stamp.quantize(MICROSECOND) if stamp.is_finite() else stamp


def format_stamp(stamp: Decimal) -> str:
    """Format a stamp with six decimals, or with more if it needs them."""
    short = round_to_microseconds(stamp)
    return f"{short if short == stamp else stamp:f}"


def calibration_of_frame(frame: RgbdFrame) -> CameraCalibration:
    """Make the calibration of a frame, which is already undistorted.

    The depth stamps are written with the whole skew, so the depth offset is zero.
    """
    c, prior = frame.camera, frame.timing_prior
    if prior is None:
        sigmas_s: tuple[float | None, float | None] = (0.0, 0.0)
    elif prior.source is TimingSource.UNKNOWN:
        sigmas_s = (None, None)
    else:
        sigmas_s = (prior.readout_sigma_s, prior.depth_offset_sigma_s)
    intrinsics = (c.width, c.height, c.fx, c.fy, c.cx, c.cy)
    return CameraCalibration(
        *intrinsics,
        NO_DISTORTION,
        frame.depth_factor,
        frame.readout_s,
        readout_sigma_s=sigmas_s[0],
        depth_offset_sigma_s=sigmas_s[1],
    )
