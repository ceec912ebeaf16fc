"""A camera with minimal cost: random images from memory at a fixed rate."""

import time
from dataclasses import replace

import numpy as np

from drivers.camera import CameraCounters, Clock, FrameTimeout, PinholeCamera, RgbdCamera, RgbdFrame

IMAGE_COUNT = 8
WIDTH, HEIGHT = 640, 480


class PreloadedCamera(RgbdCamera):
    """Copies an image pair at every tick of its clock, as a driver does.

    A frame's `device_stamp_s` is the CPU time that its process has used so far.
    """

    name = "preloaded"
    clock = Clock.MONOTONIC

    def __init__(self, rate_hz: float) -> None:
        self._period_s = 1.0 / rate_hz
        rng = np.random.default_rng(1)
        self._frames = [_random_images(rng) for _ in range(IMAGE_COUNT)]
        self._seq, self._due_s = 0, 0.0

    def open(self) -> None:
        """Start the clock."""
        self._seq, self._due_s = 0, time.monotonic()

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame."""
        wait_s = self._due_s - time.monotonic()
        time.sleep(max(0.0, min(wait_s, timeout_s)))
        if wait_s > timeout_s:
            raise FrameTimeout
        source = self._frames[self._seq % IMAGE_COUNT]
        frame = replace(
            source,
            seq=self._seq,
            stamp_s=self._due_s,
            color_bgr=source.color_bgr.copy(),
            depth_raw=source.depth_raw.copy(),
            device_stamp_s=time.process_time(),
            receive_time_s=time.monotonic(),
        )
        self._seq += 1
        self._due_s += self._period_s
        return frame

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    @property
    def counters(self) -> CameraCounters:
        """Empty counters: no frame is ever lost."""
        return CameraCounters(delivered=self._seq)


def _random_images(rng: np.random.Generator) -> RgbdFrame:
    return RgbdFrame(
        seq=0,
        stamp_s=0.0,
        receive_time_s=0.0,
        color_bgr=rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8),
        depth_raw=rng.integers(0, 4000, (HEIGHT, WIDTH), np.uint16),
        depth_factor=1000.0,
        camera=PinholeCamera(WIDTH, HEIGHT, 525.0, 525.0, 319.5, 239.5),
    )
