"""A frame, and what the service said of it, as a record of the ring."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.shared_frames.depth_unpacking import unpack_depth
from drivers.core.shared_frames.record_ring import RecordRingWriter, RingRecord
from vo_service.types import OdometryUpdate, TrackingState

# A note is far smaller; its only text is the reason.
MAX_METADATA_BYTES = 4096
_MAX_REASON_CHARS = 200

# Packs a depth image into the first bytes of what it is given; how many.
PackDepth = Callable[[NDArray[np.uint16], NDArray[np.uint8]], int]


@dataclass(frozen=True)
class PublishedOdometry:
    """What the service published of a frame; see `OdometryUpdate`."""

    seq: int
    stamp_s: float
    state: TrackingState
    reason: str
    epoch: int
    has_pose: bool  # of its own: not the last good one held
    inliers: int
    T_world_camera: Array


@dataclass(frozen=True)
class FrameMetadata:
    """Everything of a frame but its images.

    depth_bytes  how long the packed depth is; the color follows it
    more         what whoever put it in the ring has to say beside, if anything
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
    published: PublishedOdometry
    depth_bytes: int
    extra: object = None

    @property
    def clock_offset_s(self) -> float:
        """From the camera's clock to the published one, as it was when this frame was published."""
        return self.published.stamp_s - self.stamp_s


def write_frame(
    ring: RecordRingWriter, update: OdometryUpdate, pack: PackDepth, extra: object = None
) -> None:
    """Copy a frame into the ring, `more` in its note. Raises OSError without memory for it."""
    frame = update.frame
    bound = 2 * frame.depth_raw.size + frame.color_bgr.nbytes + MAX_METADATA_BYTES
    room = ring.reserve(bound, frame.stamp_s)
    depth_bytes = pack(frame.depth_raw, room)
    length = depth_bytes + frame.color_bgr.nbytes
    room[depth_bytes:length].reshape(frame.color_bgr.shape)[:] = frame.color_bgr
    note = pickle.dumps(_make_metadata(update, depth_bytes, extra))
    ring.commit(length, note, bound, frame.stamp_s)


def decode_metadata(metadata: bytes) -> FrameMetadata:
    """The note of a frame's record."""
    found: FrameMetadata = pickle.loads(metadata)
    return found


def decode_frame(record: RingRecord, clock_offset_s: float) -> RgbdFrame:
    """The frame of a record, bit for bit, with its stamp moved by an offset.

    One offset for a whole folder: published stamps may go back where the clock is set.
    """
    note = decode_metadata(record.metadata)
    width, height = note.camera.width, note.camera.height
    color = np.frombuffer(record.payload, np.uint8, offset=note.depth_bytes)
    return RgbdFrame(
        seq=note.seq,
        stamp_s=note.stamp_s + clock_offset_s,
        receive_time_s=note.receive_time_s,
        color_bgr=color.reshape(height, width, 3),
        depth_raw=unpack_depth(record.payload[: note.depth_bytes], height, width),
        depth_factor=note.depth_factor,
        camera=note.camera,
        skew_s=note.skew_s,
        lost_packets=note.lost_packets,
        gravity_m_s2=note.gravity_m_s2,
        readout_s=note.readout_s,
    )


def _make_metadata(update: OdometryUpdate, depth_bytes: int, extra: object) -> FrameMetadata:
    frame = update.frame
    said = PublishedOdometry(
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
        published=said,
        depth_bytes=depth_bytes,
        extra=extra,
    )
