"""What a frame has to say of the pose of a camera that is calm, and of one that is not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.odometry.keyframe.found_motions import STAMP_S, WAY, found_at
from tests.vo_service.odometry.keyframe.rolling_views import BRISK, series_exponential
from vo_service.odometry.keyframe.parameters import SLIGHT
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.steadiness import shares, steadied
from vo_service.odometry.keyframe.way import Way

# A millimetre, and a milliradian.
SIGMA = 1e-3
OFF = SIGMA * np.array([0.5, -0.3, 0.2, 0.4, 0.1, -0.3])
FASTER = np.array([0.01, 0.02, -0.01, 0.02, 0.01, 0.03])


def steady(times: float, way: Way = WAY, stamp_s: float = STAMP_S) -> tuple[Found, Found, float]:
    """What was found, the same steadied, and the unrest."""
    found = found_at(times * OFF, FASTER)
    return found, *steadied(found, SIGMA**2 * np.eye(6), way, stamp_s)


def test_what_lies_within_its_noise_hardly_moves_a_calm_camera() -> None:
    _, calm, unrest = steady(1.0)
    assert unrest == pytest.approx(np.mean((OFF / SIGMA) ** 2))
    expected = BRISK.at(STAMP_S) @ series_exponential(SLIGHT * OFF)
    np.testing.assert_allclose(calm.T_world_camera, expected, atol=1e-12)
    change = calm.alignment.camera_velocity - BRISK.velocity
    np.testing.assert_allclose(change, shares(unrest)[1] * FASTER, atol=1e-12)
    assert 0.0 < shares(unrest)[1] < SLIGHT


def test_what_is_beyond_its_noise_is_taken_as_it_was_found() -> None:
    found, taken, _ = steady(6.0)
    assert taken is found


def test_a_camera_that_was_agitated_of_late_is_not_calm_yet() -> None:
    found, taken, unrest = steady(1.0, replace(WAY, unrest=4.0))
    assert taken is found
    assert 1.0 < unrest < 4.0


def test_after_a_long_time_nothing_is_expected() -> None:
    found, taken, _ = steady(1.0, replace(WAY, stamp_s=0.5))
    assert taken is found


def test_the_shares_of_a_frame_grow_with_the_unrest() -> None:
    of_pose, of_velocity = np.array([shares(unrest) for unrest in (0.0, 1.3, 1.6, 2.0, 9.0)]).T
    assert of_pose[0] == SLIGHT
    assert np.all(np.diff(of_pose[:4]) > 0)
    assert np.all(np.diff(of_velocity[:3]) > 0)
    assert of_pose[-1] == of_velocity[-1] == 1.0
