"""How whole frames lie in shared memory."""

import math
import mmap
from contextlib import suppress
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.errors import UserFacingError

SLOT_COUNT = 4
# Room for 12 megapixels. Memory that is never touched is never used: 640x480 takes 1.5 MB a slot.
SLOT_BYTES = 64 * 2**20
# Ordinal in the ring, seq, lost_packets; stamps, skew, readout and depth factor; gravity; camera.
_HEADER = Struct("=3q 6d 3d 2q 4d")
_HEADER_BYTES = 256  # keeps the images aligned
_NO_GRAVITY = (math.nan,) * 3


class FrameSlots:
    """`SLOTS` frames in one block of memory. Who may touch which slot is the ring's business."""

    def __init__(self, memory_fd: int) -> None:
        """Map the memory, SLOTS * SLOT_BYTES of it."""
        self._memory = mmap.mmap(memory_fd, SLOT_COUNT * SLOT_BYTES)

    def write(self, slot: int, ordinal: int, frame: RgbdFrame) -> None:
        """Copy a frame into a slot. Raises UserFacingError if it is too large for any."""
        camera = frame.camera
        if _HEADER_BYTES + camera.width * camera.height * 5 > SLOT_BYTES:
            raise UserFacingError(
                f"frames of {camera.width}x{camera.height} are too large to come from a process "
                "of its own; choose a smaller mode of the camera"
            )
        values = _pack_header(ordinal, frame)
        _HEADER.pack_into(self._memory, slot * SLOT_BYTES, *values)
        colour, depth = self._images(slot, camera.width, camera.height)
        np.copyto(colour, frame.color_bgr)
        np.copyto(depth, frame.depth_raw)

    def read(self, slot: int) -> tuple[int, RgbdFrame]:
        """The ordinal and a copy of the frame in a slot."""
        values = _HEADER.unpack_from(self._memory, slot * SLOT_BYTES)
        colour, depth = self._images(slot, *values[12:14])
        return values[0], _make_frame(values, colour.copy(), depth.copy())

    def close(self) -> None:
        """Unmap the memory."""
        # Ctrl-C may have come in the middle of a copy, and its traceback still hold the images:
        # the memory is then unmapped when that is forgotten.
        with suppress(BufferError):
            self._memory.close()

    def _images(
        self, slot: int, width: int, height: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        """Colour and depth where they lie."""
        begin = slot * SLOT_BYTES + _HEADER_BYTES
        depth_begin = begin + 3 * width * height
        depth_begin += depth_begin % 2
        return (
            np.ndarray((height, width, 3), np.uint8, self._memory, begin),
            np.ndarray((height, width), np.uint16, self._memory, depth_begin),
        )


def _pack_header(ordinal: int, frame: RgbdFrame) -> tuple[float, ...]:
    """What is not image, as numbers; NaN stands for None."""
    device_stamp_s = math.nan if frame.device_stamp_s is None else frame.device_stamp_s
    gravity = _NO_GRAVITY if frame.gravity_m_s2 is None else frame.gravity_m_s2
    c = frame.camera
    return (
        *(ordinal, frame.seq, frame.lost_packets),
        *(frame.stamp_s, frame.receive_time_s, device_stamp_s),
        *(frame.skew_s, frame.readout_s, frame.depth_factor),
        *gravity,
        *(c.width, c.height, c.fx, c.fy, c.cx, c.cy),
    )


def _make_frame(
    values: tuple[Any, ...], color: NDArray[np.uint8], depth: NDArray[np.uint16]
) -> RgbdFrame:
    _, seq, lost_packets, stamp_s, arrival_s, device_stamp_s = values[:6]
    skew_s, readout_s, depth_factor = values[6:9]
    gravity = values[9:12]
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        receive_time_s=arrival_s,
        color_bgr=color,
        depth_raw=depth,
        depth_factor=depth_factor,
        camera=PinholeCamera(*values[12:18]),
        device_stamp_s=None if math.isnan(device_stamp_s) else device_stamp_s,
        skew_s=skew_s,
        lost_packets=lost_packets,
        gravity_m_s2=None if math.isnan(gravity[0]) else gravity,
        readout_s=readout_s,
    )
