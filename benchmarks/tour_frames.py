"""Tours of the virtual Kinect, of any length: rendered as they are needed, and not kept."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TypeVar

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.faults import Images
from drivers.synthetic.motion import make_path
from drivers.synthetic.render import make_renderer
from drivers.synthetic.scene import ROOM_HEIGHT_M

THREADS = 2
AHEAD = 6
T = TypeVar("T")


def tour_config(seed: int, seconds: float, twins: bool) -> SyntheticConfig:
    """A tour with noise, steps of the depth and rolling shutter.

    What only makes it slow to render is left out: motion blur and smooth edges.
    """
    config = SyntheticConfig(
        seed=seed, duration_s=seconds, motion=Motion.TOUR, twin_corners=twins, texel_m=0.003
    )
    return replace(config, colour=replace(config.colour, exposure_s=0.0, smooth_edges=False))


def true_poses(config: SyntheticConfig) -> Array:
    """T_room_camera (N, 4, 4) of all frames."""
    times_s = np.arange(config.frame_count) / config.rate_hz
    return make_path(config, ROOM_HEIGHT_M).poses(times_s)


def rendered_frames(config: SyntheticConfig) -> Iterator[RgbdFrame]:
    """All frames in order, a few of them rendered ahead on two threads."""
    renderer = make_renderer(config, THREADS)
    for seq, images in enumerate(made_ahead(renderer.render, config.frame_count)):
        yield as_frame(config, seq, images)


def as_frame(config: SyntheticConfig, seq: int, images: Images) -> RgbdFrame:
    """Images as frame `seq` of a camera of `config`."""
    stamp_s = round(seq / config.rate_hz, 6)
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        arrival_s=stamp_s,
        colour_bgr=images.colour,
        depth_raw=images.depth,
        depth_factor=config.depth_factor,
        camera=config.camera,
        skew_s=config.timing.skew_s,
        readout_s=config.timing.readout_s,
    )


def made_ahead(make: Callable[[int], T], count: int) -> Iterator[T]:
    """What `make` makes of 0 to `count` - 1, in order; the next few are being made meanwhile."""
    with ThreadPoolExecutor(THREADS) as pool:
        made: deque[Future[T]] = deque()
        try:
            for number in range(count):
                made.append(pool.submit(make, number))
                if len(made) > AHEAD:
                    yield made.popleft().result()
            while made:
                yield made.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
