"""Tours of the virtual Kinect, of any length: rendered as they are needed, and not kept."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.virtual_frames import THREADS, make_frame, prefetch
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.fault_injection import RenderedImages
from drivers.synthetic.motion.factory import make_motion
from drivers.synthetic.renderer import make_renderer
from drivers.synthetic.room import ROOM_HEIGHT_M


def make_tour_config(seed: int, seconds: float, aliased_corners: bool) -> SyntheticConfig:
    """A tour with noise, steps of the depth and rolling shutter.

    What only makes it slow to render is left out: motion blur and smooth edges.
    """
    config = SyntheticConfig(
        seed=seed,
        duration_s=seconds,
        motion=MotionKind.TOUR,
        twin_corners=aliased_corners,
        texel_m=0.003,
    )
    return replace(config, color=replace(config.color, exposure_s=0.0, smooth_edges=False))


def compute_true_poses(config: SyntheticConfig) -> Array:
    """T_room_camera (N, 4, 4) of all frames."""
    times_s = np.arange(config.frame_count) / config.rate_hz
    return make_motion(config, ROOM_HEIGHT_M).poses(times_s)


def render_frames(config: SyntheticConfig) -> Iterator[RgbdFrame]:
    """All frames in order, a few of them rendered ahead on two threads."""
    renderer = make_renderer(config, THREADS)
    for seq, images in enumerate(prefetch(renderer.render, config.frame_count)):
        yield make_tour_frame(config, seq, images)


def make_tour_frame(config: SyntheticConfig, seq: int, images: RenderedImages) -> RgbdFrame:
    """Images as frame `seq` of a camera of `config`, stamped to the microsecond."""
    return make_frame(config, seq, round(seq / config.rate_hz, 6), images)
