"""Frames of the virtual Kinect from its images, and a prefetching iterator."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from drivers.camera import RgbdFrame
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.fault_injection import RenderedImages

THREADS = 2
PREFETCH_COUNT = 6
T = TypeVar("T")


def make_frame(
    config: SyntheticConfig, seq: int, stamp_s: float, images: RenderedImages
) -> RgbdFrame:
    """Make frame `seq` of a camera of `config` from its images; it arrives at its stamp."""
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        receive_time_s=stamp_s,
        color_bgr=images.color_bgr,
        depth_raw=images.depth_raw,
        depth_factor=config.depth_factor,
        camera=config.camera,
        skew_s=config.timing.skew_s,
        readout_s=config.timing.readout_s,
    )


def prefetch(make: Callable[[int], T], count: int) -> Iterator[T]:
    """Yield `make` of 0 to `count` - 1 in order; threads make the next few ahead."""
    with ThreadPoolExecutor(THREADS) as pool:
        made: deque[Future[T]] = deque()
        try:
            for number in range(count):
                made.append(pool.submit(make, number))
                if len(made) > PREFETCH_COUNT:
                    yield made.popleft().result()
            while made:
                yield made.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
