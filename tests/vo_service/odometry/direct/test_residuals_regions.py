"""A moving region gets little weight, and the estimated motion stays right."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    UNKNOWN_MOTION,
    MovingCamera,
    add_noise,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    align,
    depth_only_weights,
    initial_residual_model,
    sample_points,
    uniform_weights,
)
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    CELL_COLUMNS,
    CELL_ROWS,
    build_image_pyramid,
)
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.points import select_points
from vo_service.odometry.direct.residuals import (
    ResidualModel,
    weigh_regions,
)
from vo_service.odometry.direct.samples import Samples

FRAME = add_noise(render_view(), 0)
POINTS = select_points(build_image_pyramid(FRAME), zero_motion(), ALL_STATIC)
# Rows and columns of cells.
PATCH = (slice(2, 4), slice(3, 6))
OTHER_WAY = MovingCamera(np.array([-0.6, 0.5, -1.0, 0.0, 0.0, 0.0]))


def with_moving_patch(frame: RgbdFrame, other: RgbdFrame) -> RgbdFrame:
    """Return the frame with a patch of another camera's view."""
    rows, columns = PATCH
    height, width = (
        a // b for a, b in zip(frame.gray.shape, (CELL_ROWS, CELL_COLUMNS), strict=True)
    )
    within = np.s_[
        rows.start * height : rows.stop * height, columns.start * width : columns.stop * width
    ]
    color, depth = frame.color_bgr.copy(), frame.depth_raw.copy()
    color[within], depth[within] = other.color_bgr[within], other.depth_raw[within]
    return replace(frame, color_bgr=color, depth_raw=depth)


def align_frame(frame: RgbdFrame, weights: Array) -> DirectAlignment:
    return align(POINTS, build_image_pyramid(frame), np.eye(4), UNKNOWN_MOTION, 1.0, weights)


def in_patch(weights: Array) -> tuple[Array, Array]:
    """Weights of depth inside of the patch, and outside."""
    grid = weights[1].reshape(CELL_ROWS, CELL_COLUMNS)
    patch = np.zeros(grid.shape, np.bool_)
    patch[PATCH] = True
    return grid[patch], grid[~patch]


def test_a_moving_patch_gets_little_weight_and_the_motion_stays_right() -> None:
    here, there = render_view(BRISK, 0.1), render_view(OTHER_WAY, 0.1)
    found = align_frame(add_noise(with_moving_patch(here, there), 1), uniform_weights())
    inside, outside = in_patch(found.cell_weights)
    assert inside.max() < 0.5
    assert np.median(outside) == 1.0
    assert np.mean(outside > 0.5) > 0.9
    assert not found.is_static.reshape(CELL_ROWS, CELL_COLUMNS)[PATCH].any()
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.1), 0.002, 0.05)


def test_without_moving_objects_all_regions_have_full_weight() -> None:
    found = align_frame(add_noise(render_view(BRISK, 0.1), 1), uniform_weights())
    assert found.is_static.mean() > 0.95
    assert found.cell_weights.mean() > 0.95


def test_samples_without_weight_stay_without_weight() -> None:
    found = align_frame(add_noise(render_view(BRISK, 0.1), 1), depth_only_weights())
    assert not found.cell_weights[0].any()
    assert found.cell_weights[1].mean() > 0.9
    assert_close(inverse(found.T_camera_keyframe), BRISK.pose_at(0.1), 0.002, 0.05)


def samples_at_rest() -> tuple[Samples, ResidualModel]:
    images = build_image_pyramid(add_noise(render_view(), 1))
    residual_model = initial_residual_model(images, POINTS[0])
    residual_model = residual_model._replace(sigma_brightness=3.0, sigma_depth=1e-3)
    return sample_points(POINTS, images, np.eye(4), zero_motion(), 0), residual_model


@pytest.mark.parametrize("worse_by", [15.0, 60.0, 120.0])
def test_a_cell_with_a_larger_error_has_less_weight(worse_by: float) -> None:
    samples, residual_model = samples_at_rest()
    before = weigh_regions(POINTS[0], samples, residual_model, uniform_weights())
    odd = samples.cell == 20
    samples.brightness[odd] += np.where(np.arange(odd.sum()) % 2, worse_by, 0.0)
    after = weigh_regions(POINTS[0], samples, residual_model, uniform_weights())
    assert after[0, 20] == after[1, 20] < 0.5 < before[0, 20]
    others = np.arange(len(after[0])) != 20
    np.testing.assert_allclose(after[:, others], before[:, others], rtol=0.1)


@pytest.mark.parametrize(("sign", "is_lowered"), [(-1, True), (1, False)])
def test_a_cell_that_is_seen_through_loses_weight_a_slightly_occluded_one_does_not(
    sign: int, is_lowered: bool
) -> None:
    samples, residual_model = samples_at_rest()
    (in_cell,) = np.nonzero(samples.cell == 20)
    odd = in_cell[::3]
    samples.occlusion[odd] = sign
    samples.brightness[odd] = samples.depth_residual[odd] = np.nan
    weights = weigh_regions(POINTS[0], samples, residual_model, uniform_weights())
    assert (weights[1, 20] < 0.9) == is_lowered


def test_without_samples_all_weights_stay() -> None:
    samples, residual_model = samples_at_rest()
    samples.cell[:] = -1
    np.testing.assert_array_equal(
        weigh_regions(POINTS[0], samples, residual_model, uniform_weights()), uniform_weights()
    )
