"""Writing of frames into shared memory. `frame_record` has the format, and reads them.

It is made for speed, as each frame of a live camera is packed. A process that only reads loads no
Numba.
"""

import pickle
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from drivers.core.process.record_ring import RecordRingWriter
from drivers.freenect.bayer import extract_mosaic
from drivers.recording.odometry import OdometryRecord
from vo_service.frame_record import (
    ESCAPE_CODE,
    MAX_STEP_CODE,
    ZERO_STEP_CODE,
    FrameMetadata,
    PublishedOdometry,
    escapes_offset,
    max_packed_bytes,
)
from vo_service.types.odometry_update import OdometryUpdate

# Upper bounds; the only text in the metadata is the reason, beside the messages of the wheels. One
# has 750 bytes.
MAX_ODOMETRY_BYTES = 16_384
MAX_METADATA_BYTES = 4096 + MAX_ODOMETRY_BYTES
ODOMETRY_OVERHEAD_BYTES = 64
_MAX_REASON_CHARS = 200


def write_frame(
    ring: RecordRingWriter,
    update: OdometryUpdate,
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
    bound = max_packed_bytes(frame.depth_raw.size) + frame.color_bgr.nbytes + MAX_METADATA_BYTES
    buffer = ring.reserve(bound, frame.stamp_s)
    depth_bytes = pack_depth(frame.depth_raw, buffer)
    length = depth_bytes + pack_color(frame.color_bgr, buffer[depth_bytes:])
    metadata = pickle.dumps(_make_metadata(update, depth_bytes, extra, _newest(odometry)))
    ring.commit(length, metadata, bound, frame.stamp_s)


def pack_depth(depth_raw: NDArray[np.uint16], out: NDArray[np.uint8]) -> int:
    """Pack an image; one that would not shrink is copied.

    Args:
        depth_raw: (height, width) uint16.
        out: Buffer of at least `max_packed_bytes` uint8, at an even address.

    Returns:
        The number of bytes written to the start of `out`.
    """
    pixels = depth_raw.size
    values = _read_only(depth_raw).reshape(-1)
    begin = escapes_offset(pixels)
    # Packed data stay smaller than a copy, so that the decoder knows a copy by its size.
    max_escapes = max(0, (max_packed_bytes(pixels) - 2 - begin) // 2)
    escapes = out[begin : begin + 2 * max_escapes].view(np.uint16)
    count = _pack_steps(values, out[:pixels], escapes)
    if count < 0:
        out[: 2 * pixels] = values.view(np.uint8)
        return 2 * pixels
    return begin + 2 * count if count else pixels


def pack_color(color_bgr: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Pack an image to the mosaic that it was computed from; one of another kind is copied.

    Args:
        color_bgr: (height, width, 3) uint8.
        out: Buffer of at least the size of the image.

    Returns:
        The number of bytes written to the start of `out`.
    """
    height, width = color_bgr.shape[:2]
    image = _read_only(color_bgr)
    mosaic = out[: height * width].reshape(height, width)
    if extract_mosaic(image, mosaic):
        return mosaic.size
    out[: image.size] = image.reshape(-1)
    return color_bgr.size


def compile_kernels() -> None:
    """Compile or load the kernels before the first frame, since that holds the GIL."""
    pack_depth(np.zeros((2, 2), np.uint16), np.zeros(8, np.uint8))
    pack_color(np.zeros((2, 2, 3), np.uint8), np.empty(12, np.uint8))


def _read_only(image: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous view of one kind, as kernels are compiled for a kind of array.

    Some cameras' arrays are read-only.
    """
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view


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


@kernel
def _pack_steps(
    values: NDArray[np.uint16], codes: NDArray[np.uint8], escapes: NDArray[np.uint16]
) -> Any:
    """Return the number of escapes; -1 if there are more than `escapes` holds."""
    last = np.uint16(0)
    count = 0
    for pixel in range(values.size):
        value = values[pixel]
        if value == 0:
            codes[pixel] = 0
            continue
        step = np.uint16(value - last)  # modulo 65536, so that every difference has 16 bits
        last = value
        code = np.uint16(step + ZERO_STEP_CODE)
        if code != 0 and code <= MAX_STEP_CODE:
            codes[pixel] = code
        elif count == escapes.size:
            return -1
        else:
            codes[pixel] = ESCAPE_CODE
            escapes[count] = step
            count += 1
    return count
