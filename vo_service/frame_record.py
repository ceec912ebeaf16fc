"""Records in shared memory: a frame with its update, and back.

Depth is packed without loss to about half the size, in a quarter of a millisecond: the code is made
for speed. Each pixel takes one byte: its difference from the previous pixel with a reading. A
difference that does not fit takes two more bytes in a second part (the escapes). A Kinect's depth
takes 1.0 to 1.1 bytes per pixel.
"""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame, TimingPrior
from drivers.core.geometry import Array
from drivers.core.process.record_ring import RecordRingWriter, RingRecord
from drivers.recording.odometry import OdometryRecord
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

# Upper bounds; the only text in the metadata is the reason, beside the messages of the wheels. One
# has 750 bytes.
MAX_ODOMETRY_BYTES = 16_384
MAX_METADATA_BYTES = 4096 + MAX_ODOMETRY_BYTES
ODOMETRY_OVERHEAD_BYTES = 64
_MAX_REASON_CHARS = 200

# Packs a depth image into the start of a buffer, and returns the number of bytes used.
PackDepth = Callable[[NDArray[np.uint16], NDArray[np.uint8]], int]


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
        depth_bytes: Length of the packed depth, bytes; the color image follows it.
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


def write_frame(
    ring: RecordRingWriter,
    update: OdometryUpdate,
    pack: PackDepth,
    extra: object = None,
    odometry: Sequence[OdometryRecord] = (),
) -> None:
    """Copy a frame into the ring.

    Args:
        extra: Further data for the metadata; it is pickled.
        odometry: Messages of the wheels; the newest `MAX_ODOMETRY_BYTES` are kept.

    Raises:
        OSError: If there is not enough memory for the frame.
    """
    frame = update.frame
    bound = 2 * frame.depth_raw.size + frame.color_bgr.nbytes + MAX_METADATA_BYTES
    buffer = ring.reserve(bound, frame.stamp_s)
    depth_bytes = pack(frame.depth_raw, buffer)
    length = depth_bytes + frame.color_bgr.nbytes
    buffer[depth_bytes:length].reshape(frame.color_bgr.shape)[:] = frame.color_bgr
    metadata = pickle.dumps(_make_metadata(update, depth_bytes, extra, _newest(odometry)))
    ring.commit(length, metadata, bound, frame.stamp_s)


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
    color = np.frombuffer(record.payload, np.uint8, offset=metadata.depth_bytes)
    return RgbdFrame(
        seq=metadata.seq,
        stamp_s=metadata.stamp_s + clock_offset_s,
        receive_time_s=metadata.receive_time_s,
        color_bgr=color.reshape(height, width, 3),
        depth_raw=unpack_depth(record.payload[: metadata.depth_bytes], height, width),
        depth_factor=metadata.depth_factor,
        camera=metadata.camera,
        skew_s=metadata.skew_s,
        lost_packets=metadata.lost_packets,
        gravity_m_s2=metadata.gravity_m_s2,
        readout_s=metadata.readout_s,
        timing_prior=metadata.timing_prior,
    )


def _newest(odometry: Sequence[OdometryRecord]) -> Sequence[OdometryRecord]:
    """Return the newest messages that have a place in the metadata."""
    sizes = accumulate(len(each.message) + ODOMETRY_OVERHEAD_BYTES for each in reversed(odometry))
    count = sum(size <= MAX_ODOMETRY_BYTES for size in sizes)
    return tuple(odometry[len(odometry) - count :])


def _make_metadata(
    update: OdometryUpdate, depth_bytes: int, extra: object, odometry: Sequence[OdometryRecord]
) -> FrameMetadata:
    frame = update.frame
    published = PublishedOdometry(
        seq=update.seq,
        stamp_s=update.stamp_s,
        state=update.state,
        reason=update.reason[:_MAX_REASON_CHARS],
        epoch=update.epoch,
        has_pose=update.estimate.ok,
        inliers=update.estimate.inliers,
        T_world_camera=update.T_world_camera,
    )
    return FrameMetadata(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        receive_time_s=frame.receive_time_s,
        depth_factor=frame.depth_factor,
        camera=frame.camera,
        skew_s=frame.skew_s,
        lost_packets=frame.lost_packets,
        gravity_m_s2=frame.gravity_m_s2,
        readout_s=frame.readout_s,
        timing_prior=frame.timing_prior,
        published=published,
        depth_bytes=depth_bytes,
        extra=extra,
        odometry=odometry,
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


def max_packed_bytes(pixels: int) -> int:
    """Return the largest packed size of a depth image."""
    return 2 * pixels
