"""Compile the virtual Kinect's kernels, or load them from the cache."""

import time
from dataclasses import replace

from drivers.camera import PinholeCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.renderer import make_renderer

CAMERA = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)


def warm_up_renderer() -> float:
    """Render a tiny frame with all sensor faults and one with none; return the seconds it took."""
    begin_s = time.monotonic()
    for config in (SyntheticConfig(), SyntheticConfig.ideal()):
        tiny = replace(config, camera=CAMERA, duration_s=0.1, texel_m=0.05)
        make_renderer(tiny, threads=1).render(0)
    return time.monotonic() - begin_s
