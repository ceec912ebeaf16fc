"""Jumps of a recording's clock: wrong stamps are left out, a clock that was set starts a run."""

from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise

# A clock counts as set when so many stamps in a row are not after an earlier one.
MAX_STALE_FRAMES = 15


def split_at_jumps(stamps_us: Sequence[int], jump_cost: int = MAX_STALE_FRAMES) -> list[list[int]]:
    """Split images into runs of rising stamps, and leave out as few as possible.

    A new run costs as much as leaving out `jump_cost` images, so that a wrong stamp, also one far
    ahead, costs its own image only. With one run, it is the longest rising subsequence; the search
    is that of patience sorting.

    Args:
        stamps_us: Stamps in the order of recording, microseconds.

    Returns:
        Indices of the images of each run, in order.
    """
    if all(before < after for before, after in pairwise(stamps_us)):
        return [list(range(len(stamps_us)))]
    # Of all selections that are worth more than k images: the smallest last stamp, and its image.
    last_stamps: list[int] = []
    last_images: list[int] = []
    previous: list[int] = []
    for image, stamp in enumerate(stamps_us):
        worth = bisect_left(last_stamps, stamp)
        before = last_images[worth - 1] if worth else -1
        if len(last_stamps) - jump_cost > worth:
            worth, before = len(last_stamps) - jump_cost, last_images[-1]
        previous.append(before)
        if worth == len(last_stamps):
            last_stamps.append(stamp)
            last_images.append(image)
        while worth >= 0 and last_stamps[worth] > stamp:
            last_stamps[worth], last_images[worth] = stamp, image
            worth -= 1
    return _runs_up_to(last_images[-1], previous, stamps_us)


def _runs_up_to(image: int, previous: Sequence[int], stamps_us: Sequence[int]) -> list[list[int]]:
    """Follow the selection back from its last image."""
    runs = [[image]]
    while (before := previous[image]) >= 0:
        if stamps_us[before] >= stamps_us[image]:
            runs.append([])
        runs[-1].append(before)
        image = before
    return [run[::-1] for run in reversed(runs)]
