"""The camera `wall:FRAMES`: it slides along a wall, 1 cm with each frame."""

import time

import numpy as np

from drivers import CameraRequest
from drivers.camera import CameraCounters, Clock, EndOfStream, PinholeCamera, RgbdCamera, RgbdFrame
from drivers.core import InputError

INTRINSICS = PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5)
DISTANCE_M, STEP_M = 1.3, 0.01
STEP_PX = round(STEP_M * INTRINSICS.fx / DISTANCE_M)


class WallCamera(RgbdCamera):
    """A wall with squares of random brightness, from a camera that moves to the right."""

    clock = Clock.RECORDED

    def __init__(self, name: str, frame_count: int) -> None:
        self.name, self._frame_count, self._seq = name, frame_count, 0
        squares = np.random.default_rng(0).integers(0, 256, (30, 40 + frame_count), np.uint8)
        self._wall = np.kron(squares, np.ones((8, 8), np.uint8))[:, :, None].repeat(3, axis=2)

    def open(self) -> None:
        """Start with the first frame."""
        self._seq = 0

    def read(self, timeout_s: float) -> RgbdFrame:
        """Return the next frame at once."""
        if self._seq == self._frame_count:
            raise EndOfStream
        left_px, self._seq = STEP_PX * self._seq, self._seq + 1
        return RgbdFrame(
            seq=self._seq - 1,
            stamp_s=self._seq / 30,
            receive_time_s=time.monotonic(),
            color_bgr=np.ascontiguousarray(self._wall[:240, left_px : left_px + 320]),
            depth_raw=np.full((240, 320), round(1000 * DISTANCE_M), np.uint16),
            depth_factor=1000.0,
            camera=INTRINSICS,
        )

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    @property
    def counters(self) -> CameraCounters:
        """The number of frames delivered."""
        return CameraCounters(delivered=self._seq)


def make_wall_camera(request: CameraRequest) -> RgbdCamera:
    """Make the camera of `--camera wall:FRAMES`."""
    if not request.argument.isdecimal():
        raise InputError(f"camera {request.source!r}: give the number of frames: wall:FRAMES")
    return WallCamera(request.source, int(request.argument))
