"""Compile the numeric kernels, or load them from the cache, before the first frame needs them."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from vo_service.methods import METHODS, FeatureSettings
from vo_service.odometry.estimate import Odometry

# Large enough for every filter and every octave to have work to do.
SIZE = 256


class StageNames:
    """A stopwatch that only tells which stage has begun."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Tell the stage's name."""
        self._tell(name)
        yield


def warm_up(method: str, tell: Callable[[str], None]) -> float:
    """Run a method on a few made-up frames; returns the seconds that took.

    `tell` gets the name of each stage as it begins. Compiled for any image size at once.
    """
    begin_s = time.monotonic()
    try_out(METHODS[method](FeatureSettings(), StageNames(tell)))
    return time.monotonic() - begin_s


def try_out(odometry: Odometry) -> None:
    """Let an odometry that is not used otherwise see the made-up frames."""
    for frame in _made_up_frames():
        odometry.estimate(frame)


def _made_up_frames() -> Iterator[RgbdFrame]:
    """A cloth of blobs over a corner, a little moved from frame to frame; then one quite different.

    Before that, most of the cloth has come nearer: that is parallax for those who need it.
    With the last one tracking is lost, so that what is only needed then is run as well.
    """
    camera = PinholeCamera(SIZE, SIZE, 300.0, 300.0, SIZE / 2, SIZE / 2)
    for number, seed in enumerate((0, 0, 0, 0, 0, 1)):
        yield RgbdFrame(
            seq=number,
            stamp_s=number / 30,
            arrival_s=0.0,
            colour_bgr=_moved(_cloth(seed), number),
            depth_raw=_corner(2000 + 2000 * seed),
            depth_factor=1000.0,
            camera=camera,
        )


def _moved(cloth: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """The cloth by as many pixels, and from the fourth frame on its lower part much further."""
    moved = np.roll(cloth, number, axis=1)
    if number > 2:
        moved[SIZE // 3 :] = np.roll(moved[SIZE // 3 :], SIZE // 5, axis=1)
    return moved


def _corner(depth_raw: int) -> NDArray[np.uint16]:
    """Three walls that meet in the middle, where the depth is greatest: they hold a camera fast."""
    v, u = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    nearer = np.maximum.reduce([v, -v // 2 + u, -v // 2 - u])
    corner: NDArray[np.uint16] = (depth_raw - 3 * nearer).astype(np.uint16)
    return corner


def _cloth(seed: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(seed).integers(0, 256, (SIZE // 8, SIZE // 8), np.uint8)
    cloth = np.kron(coarse, np.ones((8, 8), np.uint8))
    return np.repeat(cloth[:, :, None], 3, axis=2)
