"""Registered depth whose size is a fraction of color's: found in the first frame, and enlarged."""

from dataclasses import replace

from drivers.recording.image_decoding import DepthImage
from drivers.recording.recording import Recording


def check_first_frame(recording: Recording) -> Recording:
    """Load the first frame, and find by how much registered depth is to be enlarged.

    Raises:
        UnreadableFrameError: An image cannot be read or has the wrong size.
    """
    first, (width, height) = recording.frames.pairs[0], recording.image_size
    if recording.depth_camera is None:
        rows, columns = first.depth.read_depth().shape
        factor = width // columns
        if factor > 1 and (factor * columns, factor * rows) == (width, height):
            note = f"depth of {columns}x{rows} is enlarged to {width}x{height}"
            before = f"{recording.summary};" if recording.summary else f"{recording.path}:"
            summary = f"{before} {note}"
            recording = replace(recording, depth_enlargement=factor, summary=summary)
    first.load(recording.image_size, recording.depth_size)
    return recording


def enlarge(depth: DepthImage, factor: int) -> DepthImage:
    """Repeat each pixel `factor` times along both sides.

    So a reading covers the pixels of color that it was made of, and none is interpolated.
    """
    return depth if factor == 1 else depth.repeat(factor, axis=0).repeat(factor, axis=1)
