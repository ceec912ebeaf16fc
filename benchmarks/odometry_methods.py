"""SURF, SIFT and ORB as feature extractors of the same odometry."""

from vo_service.odometry.features import SurfParameters
from vo_service.odometry.profiling import StageTimer
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.tools.benchmark.baselines.opencv_features import (
    MATCH_RATIO,
    orb_odometry,
    sift_odometry,
)

METHODS = ("SURF", "SIFT", "ORB")
COUNT = 1000


def make_odometry(method: str, stopwatch: StageTimer) -> SurfOdometry:
    """Make the service's odometry with the features of one of METHODS."""
    if method == "SIFT":
        return sift_odometry(COUNT, stopwatch)
    if method == "ORB":
        return orb_odometry(COUNT, stopwatch)
    parameters = SurfParameters(match_ratio=MATCH_RATIO)
    return SurfOdometry(SurfExtractor(COUNT), parameters, timer=stopwatch)
