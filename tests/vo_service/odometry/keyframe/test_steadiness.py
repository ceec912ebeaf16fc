"""What a frame has to say of the pose of a camera that is calm, and of one that is not."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.geometry import Array, inverse
from tests.vo_service.odometry.keyframe.rolling_views import BRISK, seen, series_exponential
from vo_service.odometry.keyframe.alignment import Alignment, start_fit
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.local_map import make_keyframe
from vo_service.odometry.keyframe.movement import at_constant, at_rest, in_axes
from vo_service.odometry.keyframe.parameters import SLIGHT
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.steadiness import shares, steadied
from vo_service.odometry.keyframe.way import SAME_LIGHT, Way

T_WORLD_KEYFRAME = BRISK.at(-0.1)
KEYFRAME = make_keyframe(seen(), make_images(seen()), T_WORLD_KEYFRAME, at_rest(), ALL_STILL)
WAY = Way(BRISK.at(1.0), BRISK.velocity, 1.0, SAME_LIGHT, 120.0)
STAMP_S = 1.0 + 1 / 30
# A millimetre, and a milliradian.
SIGMA = 1e-3
OFF = SIGMA * np.array([0.5, -0.3, 0.2, 0.4, 0.1, -0.3])
FASTER = np.array([0.01, 0.02, -0.01, 0.02, 0.01, 0.03])


def found_at(off: Array) -> Found:
    """So far from where it is expected, and with another velocity."""
    T_camera_keyframe = inverse(BRISK.at(STAMP_S) @ series_exponential(off)) @ T_WORLD_KEYFRAME
    movement = in_axes(-at_constant(BRISK.velocity + FASTER), inverse(T_camera_keyframe))
    nothing = np.zeros((0, 0))
    alignment = Alignment(T_camera_keyframe, movement, start_fit(), nothing, nothing, nothing)
    return Found(KEYFRAME, alignment, WAY.tie(T_WORLD_KEYFRAME, STAMP_S))


def steady(times: float, way: Way = WAY, stamp_s: float = STAMP_S) -> tuple[Found, Found, float]:
    """What was found, the same steadied, and the unrest."""
    found = found_at(times * OFF)
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
