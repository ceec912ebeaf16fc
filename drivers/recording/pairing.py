"""Pairing of color and depth images by the nearest stamps."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.camera import MAX_PAIR_SKEW_US
from drivers.recording.recorded_frames import FramePair, RecordedFrames, RecordedImage

StampsUs = NDArray[np.int64]


def pair_nearest(color_us: StampsUs, depth_us: StampsUs, max_skew_us: int) -> list[tuple[int, int]]:
    """Pair two rising lists of stamps one to one.

    Greedy over all candidates, closest first, as in the TUM RGB-D benchmark's ``associate.py``;
    of two equally close ones the earlier is taken first. Only stamps within `max_skew_us` are
    candidates, so time and memory are linear in the length of the lists.

    Args:
        color_us: (N,) stamps of the color images, microseconds.
        depth_us: (M,) stamps of the depth images, microseconds.
        max_skew_us: Largest difference of two paired stamps, microseconds.

    Returns:
        Pairs (index in color, index in depth), in order of time.
    """
    first = np.searchsorted(depth_us, color_us - max_skew_us, side="left")
    last = np.searchsorted(depth_us, color_us + max_skew_us, side="right")
    candidates = sorted(
        (abs(int(color_us[i] - depth_us[j])), i, j)
        for i in range(len(color_us))
        for j in range(first[i], last[i])
    )
    depth_of_color: dict[int, int] = {}
    paired_depths: set[int] = set()
    for _, i, j in candidates:
        if i not in depth_of_color and j not in paired_depths:
            depth_of_color[i] = j
            paired_depths.add(j)
    return sorted(depth_of_color.items())


def pair_images(color: Sequence[RecordedImage], depth: Sequence[RecordedImage]) -> RecordedFrames:
    """Pair images by the nearest stamps, at most `MAX_PAIR_SKEW_US` apart."""
    indices = pair_nearest(stamps_us(color), stamps_us(depth), MAX_PAIR_SKEW_US)
    pairs = [FramePair(color[i], depth[j]) for i, j in indices]
    return RecordedFrames(pairs, len(color) + len(depth) - 2 * len(pairs))


def stamps_us(images: Sequence[RecordedImage]) -> StampsUs:
    """Return the (N,) stamps of images, rounded to microseconds."""
    return np.array([int(image.stamp.scaleb(6).to_integral_value()) for image in images], np.int64)
