"""Whether to believe an alignment."""

from math import sqrt

import numpy as np

from drivers.geometry import Array
from vo_service.odometry.keyframe import measure
from vo_service.odometry.keyframe.alignment import Alignment
from vo_service.odometry.keyframe.limits import GAINS, MOST, ODD_SPREADS, WRONG_SPREADS
from vo_service.odometry.keyframe.parameters import FEWEST_POINTS, HALF, LITTLE, SLIGHT
from vo_service.odometry.keyframe.readings import HIDDEN, OTHER
from vo_service.odometry.keyframe.system import GAIN, SIGMA_BRIGHTNESS, SIGMA_DEPTH


def agrees(counts: Array) -> bool:
    """Whether most of what is seen of a keyframe agrees with it."""
    return not _disagreement(counts)


def _disagreement(counts: Array) -> str:
    """What does not agree with a keyframe; "" if both do."""
    for what, agreeing, read in (
        ("depths", counts[measure.DEPTH_AGREES], counts[measure.WITH_DEPTH]),
        ("brightnesses", counts[measure.BRIGHTNESS_AGREES], counts[measure.WITH_BRIGHTNESS]),
    ):
        if agreeing < MOST * read:
            return f"{agreeing:.0f} of {read:.0f} {what} agree with the keyframe's"
    return ""


def oddness(found: Alignment) -> float:
    """How badly a keyframe fits: above 1 there may be a better motion."""
    seen = max(found.counts[measure.IN_IMAGE], 1.0)
    return float(max(_spread(found), found.counts[measure.DISREGARDED] / seen / SLIGHT))


def _spread(found: Alignment) -> float:
    """The spreads of what fits: above 1 either is odd."""
    by_depth = float(found.fit[SIGMA_DEPTH] / ODD_SPREADS[1])
    if not found.by_brightness:
        return by_depth
    return max(by_depth, float(found.fit[SIGMA_BRIGHTNESS] / ODD_SPREADS[0]))


def misfit(found: Alignment) -> float:
    """What two motions are compared by: the spreads of what fits, over its share of the view.

    `oddness` would not do: regions that do not fit are those that fit worse than most of the view
    does, so that there are none where all of it fits badly.
    """
    counts = found.counts
    share = 1.0 - counts[measure.DISREGARDED] / max(counts[measure.IN_IMAGE], 1.0)
    spread = found.fit[SIGMA_DEPTH] / ODD_SPREADS[1]
    if found.by_brightness:
        spread = sqrt(spread * found.fit[SIGMA_BRIGHTNESS] / ODD_SPREADS[0])
    return float(spread / max(share, 0.01))


def doubt(found: Alignment) -> str:
    """Why an alignment is not to be believed; "" if it is."""
    counts, fit, points = found.counts, found.fit, len(found.readings)
    seen = int(counts[measure.IN_IMAGE])
    if seen < max(LITTLE * points, FEWEST_POINTS):
        return f"{seen} of {points} points of the keyframe are in view"
    if counts[measure.DISREGARDED] > HALF * seen:
        return f"{100 * counts[measure.DISREGARDED] / seen:.0f} % of the view does not fit"
    read = int(counts[measure.WITH_DEPTH] + counts[measure.WITH_BRIGHTNESS])
    if read < FEWEST_POINTS:
        return f"only {read} readings of what is in view"
    if reason := _disagreement(counts):
        return reason
    if fit[SIGMA_DEPTH] > WRONG_SPREADS[1]:
        return "the depth does not fit the keyframe's"
    if found.by_brightness and fit[SIGMA_BRIGHTNESS] > WRONG_SPREADS[0]:
        return "the brightness does not fit the keyframe's"
    if found.by_brightness and not GAINS[0] < fit[GAIN] < GAINS[1]:
        return "the light is quite another than the keyframe's"
    return ""


def doubt_anywhere(found: Alignment) -> str:
    """The same where the camera may be anywhere by now: there something always fits somehow."""
    if reason := doubt(found):
        return reason
    return "it may be another place: the keyframe fits badly" if _spread(found) > 1.0 else ""


def hidden(found: Alignment) -> float:
    """Share of the view in which something stands in front of what the keyframe has seen."""
    count = np.count_nonzero(found.readings[:, OTHER] == HIDDEN)
    return float(count / max(count + found.counts[measure.IN_IMAGE], 1.0))


def cover(found: Alignment) -> str:
    """Why an alignment that fits may be that of a thing in front of the room; "" if it is not."""
    moving = found.counts[measure.DISREGARDED] / max(found.counts[measure.IN_IMAGE], 1.0)
    share = 1.0 - (1.0 - hidden(found)) * (1.0 - moving)
    return _told(share) if share > HALF else ""


def lack(found: Alignment) -> str:
    """What an alignment has to do without; "" if both have a say in nearly all of the view."""
    counts = found.counts
    enough = SLIGHT * counts[measure.IN_IMAGE]
    if counts[measure.WITH_BRIGHTNESS] < enough:
        return "by depth alone: no texture in view"
    if counts[measure.WITH_DEPTH] < enough:
        return "by brightness alone: no depth in view"
    return _told(hidden(found)) if hidden(found) > LITTLE else ""


def _told(share: float) -> str:
    return f"{100 * share:.0f} % of the view is covered"
