"""A frame, and what the service said of it, as a record of the ring."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.geometry import Array
from vo_service.recorder.depth_unpacking import unpack_depth
from vo_service.recorder.shared_ring import Record, RingWriter
from vo_service.types import PoseUpdate, TrackingState

# A note is far smaller; its only text is the reason.
NOTE_BOUND = 4096
_LONGEST_REASON = 200

# Packs a depth image into the first bytes of what it is given; how many.
PackDepth = Callable[[NDArray[np.uint16], NDArray[np.uint8]], int]


@dataclass(frozen=True)
class Said:
    """What the service published of a frame; see `PoseUpdate`."""

    seq: int
    stamp_s: float
    state: TrackingState
    reason: str
    epoch: int
    has_pose: bool  # of its own: not the last good one held
    inliers: int
    T_world_camera: Array


@dataclass(frozen=True)
class FrameNote:
    """Everything of a frame but its images.

    depth_bytes  how long the packed depth is; the colour follows it
    more         what whoever put it in the ring has to say beside, if anything
    """

    seq: int
    stamp_s: float
    arrival_s: float
    depth_factor: float
    camera: PinholeCamera
    skew_s: float
    lost_packets: int
    gravity_m_s2: tuple[float, float, float] | None
    readout_s: float
    said: Said
    depth_bytes: int
    more: object = None

    @property
    def offset_s(self) -> float:
        """From the camera's clock to the published one, as it was when this frame was published."""
        return self.said.stamp_s - self.stamp_s


def put_frame(ring: RingWriter, update: PoseUpdate, pack: PackDepth, more: object = None) -> None:
    """Copy a frame into the ring, `more` in its note. Raises OSError without memory for it."""
    frame = update.frame
    bound = 2 * frame.depth_raw.size + frame.colour_bgr.nbytes + NOTE_BOUND
    room = ring.reserve(bound, frame.stamp_s)
    depth_bytes = pack(frame.depth_raw, room)
    length = depth_bytes + frame.colour_bgr.nbytes
    room[depth_bytes:length].reshape(frame.colour_bgr.shape)[:] = frame.colour_bgr
    note = pickle.dumps(_note(update, depth_bytes, more))
    ring.commit(length, note, bound, frame.stamp_s)


def note_of(note: bytes) -> FrameNote:
    """The note of a frame's record."""
    found: FrameNote = pickle.loads(note)
    return found


def frame_of(record: Record, offset_s: float) -> RgbdFrame:
    """The frame of a record, bit for bit, with its stamp moved by an offset.

    One offset for a whole folder: published stamps may go back where the clock is set.
    """
    note = note_of(record.note)
    width, height = note.camera.width, note.camera.height
    colour = np.frombuffer(record.payload, np.uint8, offset=note.depth_bytes)
    return RgbdFrame(
        seq=note.seq,
        stamp_s=note.stamp_s + offset_s,
        arrival_s=note.arrival_s,
        colour_bgr=colour.reshape(height, width, 3),
        depth_raw=unpack_depth(record.payload[: note.depth_bytes], height, width),
        depth_factor=note.depth_factor,
        camera=note.camera,
        skew_s=note.skew_s,
        lost_packets=note.lost_packets,
        gravity_m_s2=note.gravity_m_s2,
        readout_s=note.readout_s,
    )


def _note(update: PoseUpdate, depth_bytes: int, more: object) -> FrameNote:
    frame = update.frame
    said = Said(
        seq=update.seq,
        stamp_s=update.stamp_s,
        state=update.state,
        reason=update.reason[:_LONGEST_REASON],
        epoch=update.epoch,
        has_pose=update.estimate.ok,
        inliers=update.estimate.inliers,
        T_world_camera=update.T_world_camera,
    )
    return FrameNote(
        seq=frame.seq,
        stamp_s=frame.stamp_s,
        arrival_s=frame.arrival_s,
        depth_factor=frame.depth_factor,
        camera=frame.camera,
        skew_s=frame.skew_s,
        lost_packets=frame.lost_packets,
        gravity_m_s2=frame.gravity_m_s2,
        readout_s=frame.readout_s,
        said=said,
        depth_bytes=depth_bytes,
        more=more,
    )
