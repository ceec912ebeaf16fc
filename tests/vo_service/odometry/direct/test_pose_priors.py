"""What wheels and a floor tell: in the alignment, in degenerate views, and without any view."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import PosePrior, RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    WALL,
    add_noise,
    remove_color,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.alignment import STATIC_PRIOR, align, uniform_weights
from vo_service.odometry.direct.gauss_newton import MotionPrior, add_pose_prior
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.motion import compose, se3_exp, zero_motion
from vo_service.odometry.direct.motion_state import NO_DRIFT
from vo_service.odometry.direct.odometry import DirectOdometry

COUNT, FIRST_PLAIN = 24, 4
SIGMAS = np.array([2e-3] * 3 + [2e-3] * 3)
WHEELS = np.diag(SIGMAS**-2.0)
TWISTS = st.tuples(*[st.floats(-0.1, 0.1)] * 6).map(np.array)


def tell(frame: RgbdFrame, index: int, scale: float = 1.02) -> RgbdFrame:
    """The frame with the motion of wheels that are 2 % off."""
    T = inverse(BRISK.pose_at((index - 1) / 30)) @ BRISK.pose_at(index / 30)
    T_scaled = T.copy()
    T_scaled[:3, 3] *= scale
    prior = PosePrior(T_scaled, WHEELS, np.zeros((6, 6)), "wheel odometry")
    return replace(frame, pose_prior=prior)


def view(index: int) -> RgbdFrame:
    return add_noise(render_view(BRISK, index / 30, (WALL,)), index)


def covered(frame: RgbdFrame) -> RgbdFrame:
    """The frame of a covered camera."""
    return replace(
        frame, color_bgr=np.zeros_like(frame.color_bgr), depth_raw=np.zeros_like(frame.depth_raw)
    )


@settings(max_examples=30)
@given(TWISTS, TWISTS)
def test_the_prior_alone_leads_to_the_predicted_pose(predicted: Array, start: Array) -> None:
    T_predicted = se3_exp(np.asarray(predicted, np.float64))
    prior = MotionPrior(np.eye(4), 0.0, np.zeros(9), np.ones(9), T_predicted, WHEELS)
    T = se3_exp(np.asarray(start, np.float64))
    for _ in range(5):
        H, g = np.eye(15), np.zeros(15)
        add_pose_prior(H, g, T, prior)
        step = np.asarray(-np.linalg.solve(H, g)[:6], np.float64)
        T = compose(T, se3_exp(step))
    np.testing.assert_allclose(T, T_predicted, atol=1e-5)


def test_the_alignment_goes_to_the_prediction_where_a_bare_wall_tells_nothing() -> None:
    bare = add_noise(render_view(planes=(WALL,), paint=0.0), 1)
    images = build_image_pyramid(bare)
    keyframe = make_keyframe(bare, images, np.eye(4), zero_motion(), ALL_STATIC)
    predicted = rigid_transform(np.eye(3), (0.02, -0.01, 0.0))  # along the wall
    prior = STATIC_PRIOR._replace(T_camera_keyframe=predicted, pose_information=1e3 * WHEELS)
    found = align(keyframe.points, images, np.eye(4), prior, 1.0, uniform_weights())
    np.testing.assert_allclose(found.T_camera_keyframe[:2, 3], predicted[:2, 3], atol=1e-3)


def test_without_a_prediction_nothing_is_added() -> None:
    H, g = np.zeros((15, 15)), np.zeros(15)
    T = np.eye(4)
    T[:3, :3] = so3_exp([np.pi, 0.0, 0.0])
    add_pose_prior(H, g, T, MotionPrior(np.eye(4), 0.0, np.zeros(9), np.ones(9)))
    assert not H.any()
    assert not g.any()


def test_wheels_keep_a_degenerate_view_degraded_instead_of_lost() -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, [tell(view(k), k) for k in range(FIRST_PLAIN)])
    plain = [tell(remove_color(view(k)), k) for k in range(FIRST_PLAIN, COUNT)]
    estimates = estimate_all(odometry, plain)
    assert {e.reason for e in estimates} == {"degenerate view: wheel odometry"}
    # Their covariance has the drift since the last good view: it is not added up again.
    assert not any(e.has_biased_error for e in estimates)
    assert all(e.ok for e in estimates)
    for k, estimate in enumerate(estimates, start=FIRST_PLAIN):
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.012, 0.2)
    assert np.trace(estimates[-1].covariance) > 10.0 * np.trace(estimates[0].covariance)


def test_wheels_go_on_where_nothing_is_in_view() -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, [tell(view(k), k) for k in range(FIRST_PLAIN)])
    dark = [tell(covered(view(k)), k) for k in range(FIRST_PLAIN, COUNT)]
    estimates = estimate_all(odometry, dark)
    assert all(e.ok and e.reason.startswith("wheel odometry only: ") for e in estimates)
    assert_close(estimates[-1].T_world_camera, BRISK.pose_at((COUNT - 1) / 30), 0.03, 0.5)
    again = odometry.estimate(tell(view(COUNT), COUNT))
    assert again.ok
    assert not again.is_reset
    assert_close(again.T_world_camera, BRISK.pose_at(COUNT / 30), 0.012, 0.2)


def test_without_wheels_the_same_view_is_lost() -> None:
    odometry = DirectOdometry()
    estimate_all(odometry, [view(k) for k in range(FIRST_PLAIN)])
    estimates = estimate_all(odometry, [covered(view(k)) for k in range(FIRST_PLAIN, 8)])
    assert not any(e.ok for e in estimates)


def test_a_good_view_outweighs_wrong_wheels() -> None:
    odometry = DirectOdometry()
    with_room = [render_view(BRISK, k / 30) for k in range(10)]
    wrong = [tell(frame, k, scale=1.2) for k, frame in enumerate(with_room)]
    for k, estimate in enumerate(estimate_all(odometry, wrong)):
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.003, 0.1)


def test_standard_deviations_of_wheels_add_up() -> None:
    prior = PosePrior(np.eye(4), WHEELS, np.zeros((6, 6)), "wheel odometry")
    drift = NO_DRIFT
    for _ in range(10):
        drift = drift.after(prior)
    assert drift.frames == 10
    np.testing.assert_allclose(np.sqrt(np.diag(drift.covariance)), 10.0 * SIGMAS, rtol=1e-6)
