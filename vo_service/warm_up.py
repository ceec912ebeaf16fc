"""Compile the numeric kernels, or load them from the cache, before the first frame needs them."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from vo_service.methods import METHODS, FeatureSettings
from vo_service.types import Odometry

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
    try_out(lambda: METHODS[method](FeatureSettings(), StageNames(tell)))
    return time.monotonic() - begin_s


def try_out(make: Callable[[], Odometry]) -> None:
    """Let odometries that are not used otherwise see made-up frames."""
    for film in (_cloth_over_a_corner(), _wall_passing_by()):
        odometry = make()
        for frame in film:
            odometry.estimate(frame)


def _cloth_over_a_corner() -> Iterator[RgbdFrame]:
    """A cloth of blobs over a corner, a little moved from frame to frame; then one quite different.

    Before that, most of the cloth has come nearer: that is parallax for those who need it.
    With the last one tracking is lost, so that what is only needed then is run as well.
    """
    for number, seed in enumerate((0, 0, 0, 0, 0, 1)):
        yield _frame(number, _moved(_cloth(seed), number), _corner(2000 + 2000 * seed))


def _wall_passing_by() -> Iterator[RgbdFrame]:
    """A cloth on a wall, first slowly, then at once by more than a quarter of the view.

    What that needs is run as well: finding the camera again, and what a keyframe that goes out of
    view asks for. Its rows are of different times, though hardly.
    """
    wall = np.full((SIZE, SIZE), 2000, np.uint16)
    for number, moved_px in enumerate((0, 2, 72)):
        frame = _frame(number, np.roll(_cloth(0), moved_px, axis=1), wall)
        yield replace(frame, readout_s=1e-6)


def _frame(number: int, colour: NDArray[np.uint8], depth_raw: NDArray[np.uint16]) -> RgbdFrame:
    return RgbdFrame(
        seq=number,
        stamp_s=number / 30,
        arrival_s=0.0,
        colour_bgr=colour,
        depth_raw=depth_raw,
        depth_factor=1000.0,
        camera=PinholeCamera(SIZE, SIZE, 300.0, 300.0, SIZE / 2, SIZE / 2),
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
