"""State of the tracking."""

from dataclasses import replace

import numpy as np

from tests.vo_service.odometry.direct.tracking_results import KEYFRAME, MOTION, make_result
from vo_service.odometry.direct import DirectTrack
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.uncertainty import DegeneracyAnalysis

FOUND = make_result(np.zeros(6), np.zeros(6))
SURE = MotionUncertainty(np.eye(6), DegeneracyAnalysis(np.arange(4.0, 10.0), np.eye(6)))


def test_the_initial_observability_is_that_of_the_keyframes_first_view() -> None:
    track = DirectTrack(KEYFRAME, MOTION, np.eye(4))
    assert track.observability_at_start(FOUND, SURE) == SURE.observability == 4.0
    assert replace(track, initial_observability=9.0).observability_at_start(FOUND, SURE) == 9.0


def test_a_recovered_keyframe_has_a_new_first_view() -> None:
    track = DirectTrack(replace(KEYFRAME), MOTION, np.eye(4), initial_observability=9.0)
    assert track.observability_at_start(FOUND, SURE) == SURE.observability
