"""Whether to believe an alignment."""

from drivers.geometry import Array
from vo_service.odometry.keyframe import measure
from vo_service.odometry.keyframe.alignment import Alignment
from vo_service.odometry.keyframe.parameters import LEAST_AGREEING, ODD_SPREADS, WRONG_SPREADS
from vo_service.odometry.keyframe.system import GAIN, SIGMA_BRIGHTNESS, SIGMA_DEPTH

# Of a keyframe's points, this share at least is in the image, and not fewer than this.
LEAST_IN_IMAGE, FEWEST_POINTS = 0.2, 100
# Gains further from one than this are no change of light.
LEAST_GAIN, MOST_GAIN = 0.45, 2.2


def agrees(counts: Array, by_brightness: bool = True) -> bool:
    """Whether most of what is seen of a keyframe agrees with it."""
    depth_agrees = counts[measure.DEPTH_AGREES] >= LEAST_AGREEING[0] * counts[measure.WITH_DEPTH]
    if not by_brightness:
        return bool(depth_agrees)
    agreeing, read = counts[measure.BRIGHTNESS_AGREES], counts[measure.WITH_BRIGHTNESS]
    return bool(depth_agrees and agreeing >= LEAST_AGREEING[1] * read)


def oddness(found: Alignment) -> float:
    """How badly a keyframe fits: above 1 there may be a better motion."""
    odd_depth = found.fit[SIGMA_DEPTH] / ODD_SPREADS[1]
    if not found.by_brightness:
        return float(odd_depth)
    return float(max(odd_depth, found.fit[SIGMA_BRIGHTNESS] / ODD_SPREADS[0]))


def doubt(found: Alignment) -> str:
    """Why an alignment is not to be believed; "" if it is."""
    counts, fit, points = found.counts, found.fit, len(found.readings)
    seen = int(counts[measure.IN_IMAGE])
    if seen < max(LEAST_IN_IMAGE * points, FEWEST_POINTS):
        return f"{seen} of {points} points of the keyframe are in view"
    if not agrees(counts, found.by_brightness):
        agreeing = int(counts[measure.DEPTH_AGREES] + counts[measure.BRIGHTNESS_AGREES])
        read = int(counts[measure.WITH_DEPTH] + counts[measure.WITH_BRIGHTNESS])
        return f"{agreeing} of {read} readings agree with the keyframe"
    if fit[SIGMA_DEPTH] > WRONG_SPREADS[1]:
        return "the depth does not fit the keyframe's"
    if found.by_brightness and fit[SIGMA_BRIGHTNESS] > WRONG_SPREADS[0]:
        return "the brightness does not fit the keyframe's"
    if found.by_brightness and not LEAST_GAIN <= fit[GAIN] <= MOST_GAIN:
        return f"the light has changed by a factor of {fit[GAIN]:.1f}"
    return ""
