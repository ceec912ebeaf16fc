"""A motion that follows an object is distinguished from a jolt of the camera."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    STILL,
    MovingCamera,
    add_noise,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry import direct
from vo_service.odometry.direct import DirectOdometry
from vo_service.odometry.direct.alignment import (
    IDENTITY_BRIGHTNESS,
    DirectAlignment,
    PointPyramid,
    align,
    uniform_weights,
)
from vo_service.odometry.direct.gauss_newton import MotionPrior
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    CELL_COLUMNS,
    CELL_ROWS,
    ImagePyramid,
    build_image_pyramid,
)
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.direct.recovery import retry_without_half
from vo_service.odometry.surf import SurfExtractor

STEP_S = 1 / 30
# The object on the left moves as if the camera moved like this.
OTHER_WAY = MovingCamera(np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0]))
JOLT = MovingCamera(np.array([0.3, -0.2, 0.3, -0.3, 0.4, 0.2]))
LEFT = 3
# The camera was at rest.
MOTION_STATE = MotionState(
    np.eye(4), np.zeros(6), 0.0, IDENTITY_BRIGHTNESS, 128.0, np.array([0.01, 0.02])
)
KEYFRAME = make_keyframe(
    add_noise(render_view(), 0),
    build_image_pyramid(add_noise(render_view(), 0)),
    np.eye(4),
    zero_motion(),
    ALL_STATIC,
)


def with_object(frame: RgbdFrame, thing: RgbdFrame) -> RgbdFrame:
    """Return the frame with the left of another one."""
    color, depth = frame.color_bgr.copy(), frame.depth_raw.copy()
    until = LEFT * frame.camera.width // CELL_COLUMNS
    color[:, :until], depth[:, :until] = thing.color_bgr[:, :until], thing.depth_raw[:, :until]
    return replace(frame, color_bgr=color, depth_raw=depth)


def align_with_weights(images: ImagePyramid, weights: Array) -> TrackingResult:
    prior = MOTION_STATE.motion_prior(np.eye(4), STEP_S)
    alignment = align(KEYFRAME.points, images, [np.eye(4)], prior, IDENTITY_BRIGHTNESS, weights)
    return TrackingResult(KEYFRAME, alignment, prior)


def of_the_left() -> Array:
    weights = np.zeros_like(uniform_weights())
    weights.reshape(2, CELL_ROWS, CELL_COLUMNS)[:, :, :LEFT] = 1.0
    return weights


def align_the_left(
    points: PointPyramid,
    images: ImagePyramid,
    initial_guesses: Sequence[Array],
    prior: MotionPrior,
    affine_brightness: tuple[float, float],
    _: Array,
) -> DirectAlignment:
    return align(points, images, initial_guesses, prior, affine_brightness, of_the_left())


def test_a_motion_that_follows_an_object_is_replaced_by_that_of_the_room() -> None:
    images = build_image_pyramid(
        add_noise(with_object(render_view(), render_view(OTHER_WAY, STEP_S)), 1)
    )
    images = replace(images, stamp_s=STEP_S)
    following = align_with_weights(images, of_the_left())
    assert_close(
        inverse(following.alignment.T_camera_keyframe), OTHER_WAY.pose_at(STEP_S), 0.004, 0.2
    )
    again = retry_without_half(following, images, MOTION_STATE)
    assert_close(inverse(again.alignment.T_camera_keyframe), np.eye(4), 0.002, 0.05)


def test_a_real_jolt_of_the_camera_is_accepted() -> None:
    images = build_image_pyramid(add_noise(render_view(JOLT, STEP_S), 1))
    again = retry_without_half(align_with_weights(images, uniform_weights()), images, MOTION_STATE)
    assert_close(inverse(again.alignment.T_camera_keyframe), JOLT.pose_at(STEP_S), 0.002, 0.05)


@pytest.mark.parametrize(
    "way",
    [replace(MOTION_STATE, velocity_noise=np.full(2, 1.0)), replace(MOTION_STATE, stamp_s=-1)],
)
def test_an_expected_motion_is_not_retried(way: MotionState) -> None:
    images = build_image_pyramid(add_noise(render_view(JOLT, STEP_S), 1))
    found = align_with_weights(images, uniform_weights())
    assert retry_without_half(found, images, way) is found


def test_a_camera_at_rest_is_not_retried() -> None:
    images = replace(build_image_pyramid(add_noise(render_view(STILL), 1)), stamp_s=STEP_S)
    found = align_with_weights(images, uniform_weights())
    assert retry_without_half(found, images, MOTION_STATE) is found


def test_the_odometry_retries_when_it_follows_an_object(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Too few features for these to find the room.
    odometry = DirectOdometry(SurfExtractor(count=1))
    estimate_all(
        odometry, [replace(add_noise(render_view(), k), stamp_s=k * STEP_S) for k in range(3)]
    )
    monkeypatch.setattr(direct, "align", align_the_left)
    moved = add_noise(with_object(render_view(), render_view(OTHER_WAY, STEP_S)), 3)
    estimate = odometry.estimate(replace(moved, stamp_s=3 * STEP_S))
    assert estimate.ok
    assert_close(estimate.T_world_camera, np.eye(4), 0.002, 0.05)
