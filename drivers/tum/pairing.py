"""Which depth image belongs to which colour image, by their stamps."""

import numpy as np
from numpy.typing import NDArray

StampsUs = NDArray[np.int64]


def pair_nearest(color_us: StampsUs, depth_us: StampsUs, max_skew_us: int) -> list[tuple[int, int]]:
    """Pair two rising lists of stamps (microseconds), at most `max_skew_us` apart, one to one.

    Greedy over all candidates, closest first, as the TUM RGB-D benchmark's own ``associate.py``;
    of two equally close the earlier goes first. Only neighbours within reach are ever listed, so
    time and memory grow with the length of the lists.

    Returns (index in colour, index in depth), in order of time.
    """
    first = np.searchsorted(depth_us, color_us - max_skew_us, side="left")
    last = np.searchsorted(depth_us, color_us + max_skew_us, side="right")
    candidates = sorted(
        (abs(int(color_us[i] - depth_us[j])), i, j)
        for i in range(len(color_us))
        for j in range(first[i], last[i])
    )
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in candidates:
        if i not in partner and j not in taken:
            partner[i] = j
            taken.add(j)
    return sorted(partner.items())
