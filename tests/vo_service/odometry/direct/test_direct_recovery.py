"""Recovery of a frame that does not fit at its predicted pose."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import PosePrior, RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    MovingCamera,
    add_noise,
    remove_color,
    render_sequence,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.alignment import align, initial_residual_model, uniform_weights
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, LocalMap, make_keyframe
from vo_service.odometry.direct.keyframe_selection import rebuild_first_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.quality import (
    POINT_STRIDE,
    TrackingResult,
    make_tracking_debug,
    project_keyframe_points,
    rejection_reason,
)
from vo_service.odometry.direct.recovery import DirectRecovery, FeatureSearch
from vo_service.odometry.features.extractor import SurfExtractor


def turned(angle_rad: float) -> Array:
    return rigid_transform(so3_exp([0.0, angle_rad, 0.0]), np.zeros(3))


def looking(angle_rad: float, k: int = 0) -> RgbdFrame:
    return add_noise(render_view(MovingCamera(T_world_start=turned(angle_rad)), k / 30), k)


def keyframe_of(frame: RgbdFrame, T: Array) -> DirectKeyframe:
    return make_keyframe(frame, build_image_pyramid(frame), T, zero_motion(), ALL_STATIC)


def told_by_features(frame: RgbdFrame, velocity_m_s: float) -> PosePrior | None:
    """What features tell half a second after the last good view, at (0, 0, 0)."""
    moving = replace(MOTION_STATE, velocity=np.array([velocity_m_s, 0.0, 0.0, 0.0, 0.0, 0.0]))
    local_map = LocalMap()
    local_map.reset(AHEAD)
    recovery = DirectRecovery(SurfExtractor())
    told = recovery.tell_motion(replace(frame, stamp_s=0.5), moving, AHEAD, local_map)
    return told.pose_prior if told else None


AHEAD, ASIDE = keyframe_of(looking(0.0), np.eye(4)), keyframe_of(looking(0.5), turned(0.5))
MOTION_STATE = MotionState(np.eye(4), np.zeros(6), 0.0)
SEARCH = FeatureSearch(SurfExtractor())


def first_try(frame: RgbdFrame) -> TrackingResult:
    return align_from(MOTION_STATE.predict_alignment(AHEAD.T_world_keyframe, frame.stamp_s), frame)


def align_from(start: Array, frame: RgbdFrame) -> TrackingResult:
    images, prior = (
        build_image_pyramid(frame),
        MOTION_STATE.motion_prior(AHEAD.T_world_keyframe, frame.stamp_s),
    )
    return TrackingResult(
        AHEAD, align(AHEAD.points, images, start, prior, 1.0, uniform_weights()), prior
    )


def recovered(frame: RgbdFrame) -> TrackingResult:
    return searched(frame, first_try(frame))


def searched(frame: RgbdFrame, first: TrackingResult) -> TrackingResult:
    local_map = LocalMap()
    local_map.reset(ASIDE)
    local_map.add(AHEAD)
    result, _ = DirectRecovery(SurfExtractor()).recover(
        frame, build_image_pyramid(frame), first, MOTION_STATE, local_map
    )
    return result


def plausible(found: TrackingResult) -> TrackingResult:
    """The same motion with valid residuals."""
    fit = initial_residual_model(AHEAD.images, AHEAD.points[0])
    fit = fit._replace(sigma_brightness=7.0, sigma_depth=1.4 * fit.depth_noise)
    alignment = replace(found.alignment, residual_model=fit, counts=at_home().alignment.counts)
    return replace(found, alignment=alignment)


def at_home() -> TrackingResult:
    return first_try(looking(0.0, 1))


def T_world_of(found: TrackingResult) -> Array:
    return found.keyframe.T_world_keyframe @ inverse(found.alignment.T_camera_keyframe)


def test_features_match_the_keyframes_in_view() -> None:
    observations = list(SEARCH.find_matches(looking(0.1, 1), [ASIDE, AHEAD]))
    assert AHEAD in [each.keyframe for each in observations]
    for each in observations:
        T_world_camera = each.keyframe.T_world_keyframe @ inverse(each.T_camera_keyframe)
        assert_close(T_world_camera, turned(0.1), 0.02, 0.5)


def test_between_searches_the_extractor_keeps_no_images() -> None:
    search = FeatureSearch(SurfExtractor())
    assert list(search.find_matches(looking(0.1), [AHEAD]))
    assert search.extractor.kept_bytes == 0


def test_features_match_nothing_in_an_unseen_view() -> None:
    random = np.random.default_rng(1)
    frame = looking(0.0)
    noise = replace(frame, color_bgr=random.integers(0, 256, frame.color_bgr.shape, np.uint8))
    assert list(SEARCH.find_matches(noise, [ASIDE, AHEAD])) == []
    assert list(SEARCH.find_matches(remove_color(frame), [ASIDE, AHEAD])) == []


@pytest.mark.parametrize(("angle_rad", "keyframe"), [(-0.3, AHEAD), (0.85, ASIDE)])
def test_a_camera_that_jumped_is_recovered(angle_rad: float, keyframe: DirectKeyframe) -> None:
    frame = looking(angle_rad, 1)
    assert rejection_reason(first_try(frame).alignment)
    found = recovered(frame)
    assert rejection_reason(found.alignment) == ""
    assert found.degradation == ""
    assert_close(T_world_of(found), turned(angle_rad), 0.003, 0.08)
    assert found.keyframe is keyframe


def test_a_good_motion_is_replaced_by_a_clearly_better_one() -> None:
    """Several similar places may fit after a while."""
    frame = looking(-0.3, 5)
    wrong = plausible(first_try(frame))
    assert not rejection_reason(wrong.alignment)
    assert MOTION_STATE.is_stale(frame.stamp_s)
    assert_close(T_world_of(searched(frame, wrong)), turned(-0.3), 0.003, 0.08)


def test_a_motion_confirmed_by_features_is_kept() -> None:
    assert_close(T_world_of(searched(looking(0.0, 1), at_home())), np.eye(4), 0.001, 0.03)


def test_of_two_matching_keyframes_the_one_with_the_valid_alignment_is_used() -> None:
    frame = looking(0.85, 1)
    in_use, other = SEARCH.find_matches(frame, [AHEAD, ASIDE])
    assert (in_use.keyframe, other.keyframe) == (AHEAD, ASIDE)
    # It fits neither at the prediction nor at the match by features, which has too little overlap.
    assert "the keyframe" in rejection_reason(first_try(frame).alignment)
    sighted = align_from(in_use.T_camera_keyframe, frame)
    assert "points of the keyframe are in view" in rejection_reason(sighted.alignment)
    assert recovered(frame).keyframe is ASIDE


def test_in_darkness_depth_alone_is_tried() -> None:
    found = recovered(remove_color(looking(0.02, 1)))
    assert found.degradation.startswith("depth only: ")
    assert not found.alignment.uses_brightness
    assert_close(T_world_of(found), turned(0.02), 0.003, 0.1)


def test_a_failed_recovery_stays_invalid() -> None:
    found = recovered(looking(np.pi, 1))
    assert rejection_reason(found.alignment) != ""


def test_a_jump_is_tracked_without_a_restart() -> None:
    angles_rad = [0.0, 0.02, 0.04, 0.3, 0.32, 0.0, 0.02]
    frames = [looking(a, k) for k, a in enumerate(angles_rad)]
    for angle_rad, estimate in zip(angles_rad, estimate_all(DirectOdometry(), frames), strict=True):
        assert estimate.ok
        assert not estimate.is_reset
        assert_close(estimate.T_world_camera, turned(angle_rad), 0.004, 0.1)


def test_a_first_keyframe_is_made_again_once_the_velocity_is_known() -> None:
    first, second = render_sequence(BRISK, 2, readout_s=0.03, skew_s=0.01)
    images = build_image_pyramid(first)
    keyframe = make_keyframe(first, images, np.eye(4), zero_motion(), ALL_STATIC)
    way = MotionState(np.eye(4), np.zeros(6), 0.0)
    prior = way.motion_prior(np.eye(4), second.stamp_s)
    start = way.predict_alignment(np.eye(4), second.stamp_s)
    align_frame = align(
        keyframe.points, build_image_pyramid(second), start, prior, 1.0, uniform_weights()
    )
    found = rebuild_first_keyframe(
        TrackingResult(keyframe, align_frame, prior), build_image_pyramid(second), ALL_STATIC
    )
    np.testing.assert_allclose(found.keyframe.motion, BRISK.motion, atol=0.04)
    assert found.keyframe.frame.depth_raw is first.depth_raw
    assert_close(T_world_of(found), BRISK.pose_at(1 / 30), 0.0007, 0.03)


def test_debug_points_are_in_both_images() -> None:
    found = first_try(looking(0.01, 1))
    debug = make_tracking_debug(AHEAD, found.alignment)
    drawn = range(0, len(AHEAD.points[0].brightness), POINT_STRIDE)
    assert len(project_keyframe_points(AHEAD)) == len(drawn)
    assert debug.inlier.mean() > 0.8
    flow_px = debug.matches_px - debug.reference_matches_px
    # A turn to the right: what is seen goes to the left.
    assert np.median(flow_px[:, 0]) == pytest.approx(-0.01 * 290, rel=0.2)
    assert abs(np.median(flow_px[:, 1])) < 0.5
    for pixels in (debug.keypoints_px, debug.reference_matches_px):
        assert pixels.min() > -1
        assert (pixels.max(axis=0) < (320, 240)).all()


@pytest.mark.parametrize("velocity_m_s", [0.0, 0.3])
def test_features_tell_the_motion(velocity_m_s: float) -> None:
    told = told_by_features(looking(0.1, 1), velocity_m_s)
    assert told is not None
    assert_close(told.T_last_camera, turned(0.1), 0.01, 0.3)


def test_features_at_rest_tell_nothing_of_a_camera_that_was_moving() -> None:
    assert told_by_features(looking(0.0, 1), 0.0) is not None
    assert told_by_features(looking(0.0, 1), 0.3) is None


def test_a_view_without_features_tells_nothing() -> None:
    assert told_by_features(remove_color(looking(0.1, 1)), 0.0) is None


def test_what_features_tell_includes_the_floor() -> None:
    floor = np.diag([0.0, 1e6, 0.0, 0.0, 0.0, 0.0])
    of_floor = PosePrior(np.eye(4), floor, floor)
    frame = looking(0.1, 1)
    alone = told_by_features(frame, 0.0)
    both = told_by_features(replace(frame, pose_prior=of_floor), 0.0)
    assert alone is not None
    assert both is not None
    np.testing.assert_array_equal(both.floor_information, floor)
    np.testing.assert_allclose(both.information, alone.information + floor)
