"""Covariance of an alignment, and the directions that it constrains."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp, so3_log
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CORNER,
    FLOOR,
    SIDE,
    WALL,
    MovingCamera,
    Plane,
    add_noise,
    remove_depth,
    render_view,
)
from vo_service.odometry.direct.alignment import STATIC_PRIOR, align, uniform_weights
from vo_service.odometry.direct.covariance import MotionUncertainty, estimate_uncertainty
from vo_service.odometry.direct.gauss_newton import MotionPrior
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.motion import se3_log, zero_motion
from vo_service.odometry.direct.samples import NUM_ROW_BANDS

# 95 % quantile of chi squared with six degrees of freedom.
CHI_SQUARED_95 = 12.59
CALM = np.zeros(2)
VAGUE = STATIC_PRIOR._replace(information=np.ones(9))


def keyframe_of(frame: RgbdFrame) -> DirectKeyframe:
    return make_keyframe(frame, build_image_pyramid(frame), np.eye(4), zero_motion(), ALL_STATIC)


def align_frame(
    keyframe: DirectKeyframe,
    frame: RgbdFrame,
    prior: MotionPrior = STATIC_PRIOR,
    velocity_noise: Array = CALM,
) -> tuple[MotionUncertainty, Array]:
    """The uncertainty, and T_keyframe_camera."""
    images = build_image_pyramid(frame)
    found = align(keyframe.points, images, np.eye(4), prior, 1.0, uniform_weights())
    return estimate_uncertainty(keyframe.points, images, found, prior, velocity_noise), inverse(
        found.T_camera_keyframe
    )


def self_uncertainty(frame: RgbdFrame) -> MotionUncertainty:
    return align_frame(keyframe_of(frame), frame)[0]


@pytest.mark.parametrize(
    ("planes", "open_directions"), [((WALL,), 3), ((WALL, FLOOR), 1), ((WALL, SIDE), 1)]
)
def test_bare_planes_leave_directions_unconstrained(
    planes: Sequence[Plane], open_directions: int
) -> None:
    view = render_view(planes=planes, paint=0.0)
    for seed in (1, 2):
        reason = self_uncertainty(add_noise(view, seed)).rejection_reason
        assert reason.startswith(f"degenerate view: {open_directions} of 6 degrees of freedom")
    assert self_uncertainty(view).rejection_reason.startswith("degenerate view: ")


@pytest.mark.parametrize("planes", [(WALL,), (WALL, FLOOR), CORNER])
def test_texture_or_a_corner_constrain_all_directions(planes: Sequence[Plane]) -> None:
    assert self_uncertainty(add_noise(render_view(planes=planes), 1)).rejection_reason == ""
    assert self_uncertainty(add_noise(render_view(paint=0.0), 1)).rejection_reason == ""


def test_texture_constrains_all_directions_without_depth_in_the_frame() -> None:
    views = [add_noise(render_view(planes=(WALL,)), seed) for seed in (1, 2)]
    uncertainty, _ = align_frame(keyframe_of(views[0]), remove_depth(views[1]))
    assert uncertainty.rejection_reason == ""


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_the_covariance_is_symmetric_and_positive(readout_s: float) -> None:
    frame = add_noise(render_view(BRISK, 0.03, readout_s=readout_s), 1)
    covariance = align_frame(keyframe_of(add_noise(render_view(), 0)), frame)[0].covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0


def sigma_m(frame: RgbdFrame, keyframe: DirectKeyframe) -> float:
    return float(np.sqrt(np.trace(align_frame(keyframe, frame)[0].covariance[:3, :3])))


def test_more_noise_increases_the_covariance() -> None:
    keyframe, frame = keyframe_of(add_noise(render_view(), 0)), render_view(BRISK, 0.03)
    sigmas = [sigma_m(add_noise(frame, 1, times), keyframe) for times in (1.0, 3.0, 9.0)]
    assert sigmas[0] < sigmas[1] < sigmas[2]


def test_fewer_points_increase_the_covariance() -> None:
    keyframe, frame = (
        keyframe_of(add_noise(render_view(), 0)),
        add_noise(render_view(BRISK, 0.03), 1),
    )
    assert sigma_m(frame, keyframe) < sigma_m(remove_depth(frame), keyframe)


def test_a_wall_with_weak_texture_constrains_motion_along_it_least() -> None:
    keyframe = keyframe_of(add_noise(render_view(planes=(WALL,), paint=0.25), 0))
    uncertainty, _ = align_frame(keyframe, add_noise(render_view(planes=(WALL,), paint=0.25), 1))
    across = np.array(WALL[0]) / np.linalg.norm(WALL[0])
    along = np.cross(across, [0.0, 1.0, 0.0])
    in_metres = uncertainty.covariance[:3, :3]
    assert along @ in_metres @ along > 2 * across @ in_metres @ across


def test_the_covariance_is_in_the_camera_axes() -> None:
    """Two planes without texture leave the direction of their edge unconstrained."""
    planes, turned = (
        (WALL, FLOOR),
        rigid_transform(so3_exp([0.0, 0.0, 0.5]), np.zeros(3)),
    )
    keyframe = keyframe_of(add_noise(render_view(planes=planes, paint=0.0), 0))
    images = build_image_pyramid(
        add_noise(render_view(MovingCamera(T_world_start=turned), planes=planes, paint=0.0), 1)
    )
    start = inverse(turned)
    found = align(keyframe.points, images, start, STATIC_PRIOR, 1.0, uniform_weights())
    covariance = estimate_uncertainty(
        keyframe.points, images, found, STATIC_PRIOR, CALM
    ).covariance[:3, :3]
    edge = np.cross(WALL[0], FLOOR[0])
    along, elsewhere = turned[:3, :3].T @ edge, turned[:3, :3] @ edge
    assert along @ covariance @ along > 1.5 * elsewhere @ covariance @ elsewhere
    most = np.linalg.eigh(covariance)[1][:, 2]
    assert abs(most @ along) > 0.95 * np.linalg.norm(edge)


@pytest.mark.parametrize("how", ["velocity not known", "agitated"])
def test_a_rolling_shutter_increases_the_covariance(how: str) -> None:
    keyframe = keyframe_of(add_noise(render_view(), 0))
    for readout_s in (0.0, 0.02):
        frame = add_noise(render_view(readout_s=readout_s), 1)
        calm = np.trace(align_frame(keyframe, frame)[0].covariance)
        if how == "agitated":
            other = np.trace(
                align_frame(keyframe, frame, STATIC_PRIOR, np.array([0.5, 1.0]))[0].covariance
            )
        else:
            other = np.trace(align_frame(keyframe, frame, VAGUE)[0].covariance)
        assert (other > 1.1 * calm) == (readout_s > 0)


@pytest.mark.parametrize("error_s", [(0.005, 0.0), (0.0, 0.003)])
def test_a_wrong_timing_moves_the_pose_by_its_timing_errors(error_s: tuple[float, float]) -> None:
    prior = STATIC_PRIOR._replace(motion=-BRISK.motion)
    keyframe, right = keyframe_of(render_view()), render_view(BRISK, readout_s=0.02, skew_s=0.01)
    frame = replace(right, readout_s=0.02 + error_s[0], skew_s=0.01 + error_s[1])
    _, T_keyframe_right = align_frame(keyframe, right, prior)
    uncertainty, T_keyframe_camera = align_frame(keyframe, frame, prior)
    moved = se3_log(np.ascontiguousarray(inverse(T_keyframe_right) @ T_keyframe_camera))
    predicted = uncertainty.timing_errors @ error_s
    assert np.linalg.norm(predicted - moved) < 0.2 * np.linalg.norm(moved)


def test_a_still_camera_has_no_timing_errors() -> None:
    uncertainty, _ = align_frame(keyframe_of(render_view()), render_view(readout_s=0.02))
    assert np.abs(uncertainty.timing_errors).max() < 1e-3


def test_a_shaking_camera_has_the_covariance_of_one_row() -> None:
    keyframe, frame = (
        keyframe_of(add_noise(render_view(), 0)),
        add_noise(render_view(readout_s=0.02), 1),
    )
    calm, agitated = (
        np.trace(
            align_frame(keyframe, frame, STATIC_PRIOR, np.array([mps, 0.0]))[0].covariance[:3, :3]
        )
        for mps in (0.0, 0.5)
    )
    in_a_row = 3 * (0.02 * 0.5) ** 2 / 12.0
    # It averages out if all bands of rows constrain the camera; if few do, less.
    assert in_a_row / (2 * NUM_ROW_BANDS) < agitated - calm < 4.0 * in_a_row


def test_the_covariance_matches_the_error_over_many_noise_samples() -> None:
    """The covariance is right within a factor, though not exactly."""
    frame, truth, distances = render_view(BRISK, 0.03), BRISK.pose_at(0.03), []
    blank = render_view()
    for seed in range(25):
        uncertainty, T = align_frame(
            keyframe_of(add_noise(blank, 2 * seed)), add_noise(frame, 2 * seed + 1)
        )
        off = inverse(T) @ truth
        error = np.concatenate([off[:3, 3], so3_log(off[:3, :3])])
        distances.append(float(error @ np.linalg.solve(uncertainty.covariance, error)))
    assert np.mean(np.array(distances) < CHI_SQUARED_95) > 0.8
    # The expected mean is six.
    assert np.mean(distances) > 0.3
