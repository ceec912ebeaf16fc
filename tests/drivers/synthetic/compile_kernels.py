"""Compile the virtual Kinect's kernels: ``python -m tests.drivers.synthetic.compile_kernels``.

Once, before tests that run at once compile them at the same time, each for itself.
"""

import os
from dataclasses import replace

from vo_service.folders import kernel_folder

# Before anything that compiles is imported.
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_folder()))

from drivers.camera import PinholeCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.render import make_renderer

TINY = PinholeCamera(64, 48, 52.5, 52.5, 31.5, 23.5)


def main() -> None:
    """A frame with all faults of the sensor, and one with none."""
    for config in (SyntheticConfig(), SyntheticConfig.ideal()):
        tiny = replace(config, camera=TINY, duration_s=0.1, texel_m=0.05)
        make_renderer(tiny, threads=1).render(0)


if __name__ == "__main__":
    main()
