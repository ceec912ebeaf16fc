"""Which depth image belongs to which colour image, by their stamps."""

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]


def pair_nearest(colour_us: Stamps, depth_us: Stamps, within_us: int) -> list[tuple[int, int]]:
    """Pair two rising lists of stamps (microseconds), at most `within_us` apart, one to one.

    Greedy over all candidates, closest first, as the TUM RGB-D benchmark's own ``associate.py``;
    of two equally close the earlier goes first. Only neighbours within reach are ever listed, so
    time and memory grow with the length of the lists.

    Returns (index in colour, index in depth), in order of time.
    """
    first = np.searchsorted(depth_us, colour_us - within_us, side="left")
    last = np.searchsorted(depth_us, colour_us + within_us, side="right")
    candidates = sorted(
        (abs(int(colour_us[i] - depth_us[j])), i, j)
        for i in range(len(colour_us))
        for j in range(first[i], last[i])
    )
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for _, i, j in candidates:
        if i not in partner and j not in taken:
            partner[i] = j
            taken.add(j)
    return sorted(partner.items())
