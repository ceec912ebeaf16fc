"""Records of frames in shared memory: their format, and how they are read.

Images are packed without loss. `frame_packing` writes them.

- Depth has one byte per pixel: the difference from the previous pixel with a reading. A difference
  that does not fit takes two more bytes in a second part (the escapes). A Kinect's depth takes 1.0
  to 1.1 bytes per pixel.
- A Kinect's color image is computed from a Bayer mosaic of one byte per pixel, which is kept
  instead. An image that is not exactly that of its mosaic is copied.
"""

import pickle
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame, TimingPrior
from drivers.core.geometry import Array
from drivers.core.process.record_ring import RingRecord
from drivers.recording.odometry import OdometryRecord
from vo_service.types.odometry_update import TrackingState


@dataclass(frozen=True)
class PublishedOdometry:
    """The part of an `OdometryUpdate` that is kept with a frame.

    Attributes:
        seq: Number of the update.
        stamp_s: Published stamp, s.
        state: Tracking state.
        reason: Reason of the state, shortened to 200 characters.
        epoch: Epoch of the pose.
        has_pose: Whether the frame has an estimate; if not, the pose is the last good one.
        inliers: Number of matches that agree with the motion.
        T_world_camera: 4x4 pose, optical axes.
    """

    seq: int
    stamp_s: float
    state: TrackingState
    reason: str
    epoch: int
    has_pose: bool
    inliers: int
    T_world_camera: Array


@dataclass(frozen=True)
class FrameMetadata:
    """A frame without its images; fields without a description are those of `RgbdFrame`.

    Attributes:
        published: The published part of its update.
        depth_bytes: Length of the packed depth, bytes; the packed color follows it.
        extra: Further data of the writer, such as the mapper's; None = none.
        odometry: Messages of the wheels before the frame, with published stamps.
    """

    seq: int
    stamp_s: float
    receive_time_s: float
    depth_factor: float
    camera: PinholeCamera
    skew_s: float
    lost_packets: int
    gravity_m_s2: tuple[float, float, float] | None
    readout_s: float
    timing_prior: TimingPrior | None
    published: PublishedOdometry
    depth_bytes: int
    extra: object = None
    odometry: Sequence[OdometryRecord] = ()

    @property
    def clock_offset_s(self) -> float:
        """Offset from the camera's clock to the published clock at this frame, s."""
        return self.published.stamp_s - self.stamp_s


def decode_metadata(metadata: bytes) -> FrameMetadata:
    """Decode the metadata of a frame's record."""
    decoded: FrameMetadata = pickle.loads(metadata)
    return decoded


def decode_frame(record: RingRecord, clock_offset_s: float) -> RgbdFrame:
    """Decode the frame of a record, bit for bit.

    Args:
        clock_offset_s: Added to the stamp, s. Use one offset for all frames of a folder: published
            stamps are not continuous after the clock was set.
    """
    metadata = decode_metadata(record.metadata)
    width, height = metadata.camera.width, metadata.camera.height
    return RgbdFrame(
        seq=metadata.seq,
        stamp_s=metadata.stamp_s + clock_offset_s,
        receive_time_s=metadata.receive_time_s,
        color_bgr=unpack_color(record.payload[metadata.depth_bytes :], height, width),
        depth_raw=unpack_depth(record.payload[: metadata.depth_bytes], height, width),
        depth_factor=metadata.depth_factor,
        camera=metadata.camera,
        skew_s=metadata.skew_s,
        lost_packets=metadata.lost_packets,
        gravity_m_s2=metadata.gravity_m_s2,
        readout_s=metadata.readout_s,
        timing_prior=metadata.timing_prior,
    )


# A pixel's byte: 0 = no reading; 1 to 254 = the difference plus 128; 255 = see the escapes.
ZERO_STEP_CODE = np.uint16(128)
MAX_STEP_CODE = np.uint16(254)
ESCAPE_CODE = np.uint8(255)


def escapes_offset(pixels: int) -> int:
    """Return the even offset where the escapes begin."""
    return pixels + pixels % 2


def unpack_depth(packed: bytes, height: int, width: int) -> NDArray[np.uint16]:
    """Unpack a (height, width) uint16 image, bit for bit.

    Args:
        packed: What `pack_depth` wrote.
        height: Rows.
        width: Columns.
    """
    pixels = height * width
    if len(packed) == 2 * pixels:
        return np.frombuffer(packed, np.uint16).reshape(height, width)
    codes = np.frombuffer(packed, np.uint8, pixels)
    steps = codes.astype(np.uint16) - ZERO_STEP_CODE
    if len(packed) > pixels:
        steps[codes == ESCAPE_CODE] = np.frombuffer(
            packed, np.uint16, offset=escapes_offset(pixels)
        )
    has_reading = codes != 0
    depth = np.zeros(pixels, np.uint16)
    depth[has_reading] = np.cumsum(steps[has_reading], dtype=np.uint16)
    return depth.reshape(height, width)


def unpack_color(packed: bytes, height: int, width: int) -> NDArray[np.uint8]:
    """Unpack a (height, width, 3) uint8 image, bit for bit.

    Args:
        packed: What `pack_color` wrote.
        height: Rows.
        width: Columns.
    """
    image = np.frombuffer(packed, np.uint8)
    if image.size == 3 * height * width:
        return image.reshape(height, width, 3)
    return _demosaic(image.reshape(height, width))


def _demosaic(mosaic: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Do the same as `drivers.freenect.bayer.demosaic`, without its compiled kernel."""
    pixels = np.pad(mosaic, 1, mode="reflect").astype(np.uint16)
    vertical = (pixels[:-2] + pixels[2:]) >> 1  # the mean of the pixels above and below
    diagonal = (vertical[:, :-2] + vertical[:, 2:]) >> 1
    vertical = vertical[:, 1:-1]
    horizontal = (pixels[1:-1, :-2] + pixels[1:-1, 2:]) >> 1
    cross = (horizontal + vertical) >> 1
    color_bgr = np.empty((*mosaic.shape, 3), np.uint8)
    even, odd = slice(0, None, 2), slice(1, None, 2)
    for rows, columns, blue_green_red in (
        (even, even, (vertical, mosaic, horizontal)),
        (even, odd, (diagonal, cross, mosaic)),
        (odd, even, (mosaic, cross, diagonal)),
        (odd, odd, (horizontal, mosaic, vertical)),
    ):
        for channel, values in enumerate(blue_green_red):
            color_bgr[rows, columns, channel] = values[rows, columns]
    return color_bgr


def max_packed_bytes(pixels: int) -> int:
    """Return the largest packed size of a depth image."""
    return 2 * pixels
