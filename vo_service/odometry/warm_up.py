"""Compile the numeric kernels, or load them from the cache, before the first frame needs them."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from vo_service.odometry.registry import METHODS, FeatureConfig
from vo_service.types import Odometry

# Large enough for every filter and every octave to have work to do.
IMAGE_SIZE_PX = 256


class StageReporter:
    """A stopwatch that only tells which stage has begun."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Tell the stage's name."""
        self._report(name)
        yield


def warm_up(method: str, report_stage: Callable[[str], None]) -> float:
    """Run a method on a few made-up frames; returns the seconds that took.

    `tell` gets the name of each stage as it begins. Compiled for any image size at once.
    """
    begin_s = time.monotonic()
    run_warm_up_frames(lambda: METHODS[method](FeatureConfig(), StageReporter(report_stage)))
    return time.monotonic() - begin_s


def run_warm_up_frames(make_odometry: Callable[[], Odometry]) -> None:
    """Let odometries that are not used otherwise see made-up frames."""
    for film in (_make_corner_frames(), _make_wall_frames()):
        odometry = make_odometry()
        for frame in film:
            odometry.estimate(frame)


def _make_corner_frames() -> Iterator[RgbdFrame]:
    """A cloth of blobs over a corner, a little moved from frame to frame; then one quite different.

    Before that, most of the cloth has come nearer: that is parallax for those who need it.
    With the last one tracking is lost, so that what is only needed then is run as well.
    """
    for number, seed in enumerate((0, 0, 0, 0, 0, 1)):
        yield _make_frame(
            number,
            _shift_texture(_make_texture(seed), number),
            _make_corner_depth(2000 + 2000 * seed),
        )


def _make_wall_frames() -> Iterator[RgbdFrame]:
    """A cloth on a wall, first slowly, then at once by more than a quarter of the view.

    What that needs is run as well: finding the camera again, and what a keyframe that goes out of
    view asks for. Its rows are of different times, though hardly.
    """
    wall = np.full((IMAGE_SIZE_PX, IMAGE_SIZE_PX), 2000, np.uint16)
    for number, moved_px in enumerate((0, 2, 72)):
        frame = _make_frame(number, np.roll(_make_texture(0), moved_px, axis=1), wall)
        yield replace(frame, readout_s=1e-6)


def _make_frame(
    number: int, color_bgr: NDArray[np.uint8], depth_raw: NDArray[np.uint16]
) -> RgbdFrame:
    return RgbdFrame(
        seq=number,
        stamp_s=number / 30,
        receive_time_s=0.0,
        color_bgr=color_bgr,
        depth_raw=depth_raw,
        depth_factor=1000.0,
        camera=PinholeCamera(
            IMAGE_SIZE_PX, IMAGE_SIZE_PX, 300.0, 300.0, IMAGE_SIZE_PX / 2, IMAGE_SIZE_PX / 2
        ),
    )


def _shift_texture(texture: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """The cloth by as many pixels, and from the fourth frame on its lower part much further."""
    moved = np.roll(texture, number, axis=1)
    if number > 2:
        moved[IMAGE_SIZE_PX // 3 :] = np.roll(
            moved[IMAGE_SIZE_PX // 3 :], IMAGE_SIZE_PX // 5, axis=1
        )
    return moved


def _make_corner_depth(depth_raw: int) -> NDArray[np.uint16]:
    """Three walls that meet in the middle, where the depth is greatest: they hold a camera fast."""
    v, u = np.mgrid[:IMAGE_SIZE_PX, :IMAGE_SIZE_PX] - IMAGE_SIZE_PX // 2
    nearer = np.maximum.reduce([v, -v // 2 + u, -v // 2 - u])
    corner: NDArray[np.uint16] = (depth_raw - 3 * nearer).astype(np.uint16)
    return corner


def _make_texture(seed: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(seed).integers(
        0, 256, (IMAGE_SIZE_PX // 8, IMAGE_SIZE_PX // 8), np.uint8
    )
    cloth = np.kron(coarse, np.ones((8, 8), np.uint8))
    return np.repeat(cloth[:, :, None], 3, axis=2)
