"""Tours of the virtual Kinect of any length, rendered on demand and not stored."""

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
    """Make the configuration of a tour with noise, depth quantization and rolling shutter.

    Motion blur and smooth edges are off, because they are slow to render.
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
    """True poses T_room_camera (N, 4, 4) of all frames."""
    times_s = np.arange(config.frame_count) / config.rate_hz
    return make_motion(config, ROOM_HEIGHT_M).poses(times_s)


def render_frames(config: SyntheticConfig) -> Iterator[RgbdFrame]:
    """Yield all frames in order; two threads render a few ahead."""
    renderer = make_renderer(config, THREADS)
    for seq, images in enumerate(prefetch(renderer.render, config.frame_count)):
        yield make_tour_frame(config, seq, images)


def make_tour_frame(config: SyntheticConfig, seq: int, images: RenderedImages) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images, with a stamp in microseconds."""
    return make_frame(config, seq, round(seq / config.rate_hz, 6), images)
