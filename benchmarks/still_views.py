"""A camera that stands still for as long as one likes: one view, measured anew for each frame."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.synthetic.colour_sensor import gain_at
from drivers.synthetic.config import Motion, SyntheticConfig
from drivers.synthetic.render import Renderer, Sight, make_renderer

THREADS = 2
AHEAD = 4
# The exposure hunts on with this period.
PERIOD_S = 20.0


@dataclass(frozen=True)
class StillView:
    """What a virtual Kinect sees from one place, with fresh noise and exposure in each frame."""

    config: SyntheticConfig
    renderer: Renderer
    sight: Sight

    @classmethod
    def of(cls, config: SyntheticConfig) -> "StillView":
        """Render the first frame of the room of `config`, but without its noise."""
        still = replace(config, motion=Motion.STILL, duration_s=PERIOD_S)
        renderer = make_renderer(still, THREADS)
        return cls(still, renderer, renderer.see(0))

    def frame(self, seq: int) -> RgbdFrame:
        """Frame `seq`: the same bytes whenever it is made."""
        config, stamp_s = self.config, seq / self.config.rate_hz
        sight = replace(self.sight, gain=gain_at(config.colour, stamp_s, PERIOD_S))
        images = self.renderer.sense(sight, np.random.default_rng([config.seed, 9, seq]))
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

    def frames(self, count: int) -> Iterator[RgbdFrame]:
        """The first `count` frames, a few of them made ahead."""
        with ThreadPoolExecutor(THREADS) as pool:
            made: deque[Future[RgbdFrame]] = deque()
            for seq in range(count):
                made.append(pool.submit(self.frame, seq))
                if len(made) > AHEAD:
                    yield made.popleft().result()
            while made:
                yield made.popleft().result()
