"""Tours of the virtual Kinect, of any length: rendered as they are needed, and not kept."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.virtual_frames import THREADS, as_frame, made_ahead
from drivers.camera import RgbdFrame
from drivers.geometry import Array
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.faults import Images
from drivers.synthetic.motion import make_path
from drivers.synthetic.render import make_renderer
from drivers.synthetic.scene import ROOM_HEIGHT_M


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
        yield tour_frame(config, seq, images)


def tour_frame(config: SyntheticConfig, seq: int, images: Images) -> RgbdFrame:
    """Images as frame `seq` of a camera of `config`, stamped to the microsecond."""
    return as_frame(config, seq, round(seq / config.rate_hz, 6), images)
