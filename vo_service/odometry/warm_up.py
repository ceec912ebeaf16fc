"""Warm-up of a method: compiles its kernels, or loads them, before the first frame."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame, TimingPrior, TimingSource
from vo_service.kernels.compilation import ensure_compiled
from vo_service.odometry.registry import METHODS, MethodConfig
from vo_service.odometry.stage_timers import StageReporter
from vo_service.types.odometry import Odometry

# Large enough for every filter and every octave.
IMAGE_SIZE_PX = 256


def warm_up(method: str, report_stage: Callable[[str], None]) -> float:
    """Run a method on a few generated frames, which compiles its kernels for any image size.

    Args:
        method: Name of the method.
        report_stage: Called with the name of each stage when it starts.

    Returns:
        The elapsed seconds.
    """
    start_s = time.monotonic()
    ensure_compiled([method], report_stage)
    run_warm_up_frames(lambda: METHODS[method](MethodConfig(), StageReporter(report_stage)))
    return time.monotonic() - start_s


def _make_corner_frames() -> Iterator[RgbdFrame]:
    """A texture that moves over a corner; in the last frame another texture.

    From the fourth frame on most of the texture moves further, which gives parallax. In the last
    frame tracking is lost, so that the recovery runs as well. No two depth images are the same.
    """
    for number, seed in enumerate((0, 0, 0, 0, 0, 1)):
        yield _make_frame(
            number,
            _shift_texture(_make_texture(seed), number),
            _make_corner_depth(2000 + 2000 * seed + number),
        )


def _make_wall_frames() -> Iterator[RgbdFrame]:
    """A texture that moves on a wall, first slowly, then by more than a quarter of the view.

    This runs the recovery and the selection of a new keyframe. The rows have slightly different
    times, so that the code for rolling shutters runs.
    """
    wall = np.full((IMAGE_SIZE_PX, IMAGE_SIZE_PX), 2000, np.uint16)
    for number, shift_px in enumerate((0, 2, 72)):
        texture = np.roll(_make_texture(0), shift_px, axis=1)
        frame = _make_frame(number, texture, wall + np.uint16(number))
        yield replace(frame, readout_s=1e-6)


def _make_pan_frames() -> Iterator[RgbdFrame]:
    """A texture that moves to and fro on a wall, with an uncertain timing, so that it is learned.

    It leaves the first keyframe and comes back to it, so that a frame is aligned with both. The
    wall recedes, which the texture does not: this takes more than one step.
    """
    prior = TimingPrior(0.0, 0.004, 0.002, TimingSource.SENSOR)
    wall = np.full((IMAGE_SIZE_PX, IMAGE_SIZE_PX), 2000, np.uint16)
    for number in range(20):
        shift_px = 8 * min(number, 19 - number)
        texture = np.roll(_make_texture(0), shift_px, axis=1)
        frame = _make_frame(number, texture, wall + np.uint16(2 * number))
        yield replace(frame, timing_prior=prior)


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
    """Shift the texture by `number` pixels, and from the fourth frame on its lower part further."""
    shifted = np.roll(texture, number, axis=1)
    if number > 2:
        shifted[IMAGE_SIZE_PX // 3 :] = np.roll(
            shifted[IMAGE_SIZE_PX // 3 :], IMAGE_SIZE_PX // 5, axis=1
        )
    return shifted


def _make_corner_depth(depth_raw: int) -> NDArray[np.uint16]:
    """Three walls that meet in the center; they constrain all degrees of freedom."""
    v, u = np.mgrid[:IMAGE_SIZE_PX, :IMAGE_SIZE_PX] - IMAGE_SIZE_PX // 2
    nearer = np.maximum.reduce([v, -v // 2 + u, -v // 2 - u])
    corner: NDArray[np.uint16] = (depth_raw - 3 * nearer).astype(np.uint16)
    return corner


def _make_texture(seed: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(seed).integers(
        0, 256, (IMAGE_SIZE_PX // 8, IMAGE_SIZE_PX // 8), np.uint8
    )
    texture = np.kron(coarse, np.ones((8, 8), np.uint8))
    return np.repeat(texture[:, :, None], 3, axis=2)


WARM_UP_SEQUENCES = (_make_corner_frames, _make_wall_frames, _make_pan_frames)


def run_warm_up_frames(
    make_odometry: Callable[[], Odometry],
    sequences: Sequence[Callable[[], Iterator[RgbdFrame]]] = WARM_UP_SEQUENCES,
) -> None:
    """Run new odometries on sequences of generated frames."""
    for make_frames in sequences:
        odometry = make_odometry()
        for frame in make_frames():
            odometry.estimate(frame)
