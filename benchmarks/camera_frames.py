"""Reads all frames of a camera that ends, such as a recording."""

from collections.abc import Iterator

from drivers.camera import EndOfStream, RgbdCamera, RgbdFrame

READ_TIMEOUT_S = 60.0


def read_all_frames(camera: RgbdCamera) -> Iterator[RgbdFrame]:
    """Yield the frames of an open camera until it ends."""
    while True:
        try:
            yield camera.read(READ_TIMEOUT_S)
        except EndOfStream:
            return
