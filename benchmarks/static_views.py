"""A stationary camera for any duration: one rendered view with fresh noise in each frame."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.virtual_frames import THREADS, make_frame, prefetch
from drivers.camera import RgbdFrame
from drivers.synthetic.color_sensor import gain_at
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.renderer import NoiselessFrame, Renderer, make_renderer

# Period of the exposure's hunting.
PERIOD_S = 20.0
# Size of the pool of noise; random offsets make all frames differ.
POOL_SIZE = 1 << 24


class PooledNoise(np.random.Generator):
    """Normal noise from random offsets in a pool that is drawn once; three times as fast."""

    def __init__(self, pool: NDArray[np.float32], seed: list[int]) -> None:
        super().__init__(np.random.PCG64(seed))
        self._pool = pool

    def standard_normal(  # type: ignore[override]
        self, size: tuple[int, ...], dtype: Any = np.float32
    ) -> NDArray[np.float32]:
        """As of any generator, but always float32 and read-only."""
        count = int(np.prod(size))
        start = int(self.integers(len(self._pool) - count))
        return self._pool[start : start + count].reshape(size)


@dataclass(frozen=True)
class StaticView:
    """The view of a stationary virtual Kinect, with fresh noise and exposure in each frame."""

    config: SyntheticConfig
    renderer: Renderer
    noiseless: NoiselessFrame
    pool: NDArray[np.float32]

    @classmethod
    def render(cls, config: SyntheticConfig) -> "StaticView":
        """Render the first frame of `config` without noise."""
        still = replace(config, motion=MotionKind.STILL, duration_s=PERIOD_S)
        renderer = make_renderer(still, THREADS)
        pool = np.random.default_rng([config.seed, 8]).standard_normal(POOL_SIZE, dtype=np.float32)
        pool.flags.writeable = False
        return cls(still, renderer, renderer.render_noiseless(0), pool)

    def frame(self, seq: int) -> RgbdFrame:
        """Make frame `seq`; its bytes are the same in every run."""
        config, stamp_s = self.config, seq / self.config.rate_hz
        sight = replace(self.noiseless, gain=gain_at(config.color, stamp_s, PERIOD_S))
        images = self.renderer.apply_sensor_noise(
            sight, PooledNoise(self.pool, [config.seed, 9, seq])
        )
        return make_frame(config, seq, stamp_s, images)

    def frames(self, count: int) -> Iterator[RgbdFrame]:
        """Yield the first `count` frames; a few are made ahead."""
        return prefetch(self.frame, count)
