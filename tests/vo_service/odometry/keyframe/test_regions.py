"""A part of the view that moves by itself counts little, and the motion stays right."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from tests.vo_service.odometry.keyframe.rolling_views import BRISK, Hand, noisy, seen
from tests.vo_service.odometry.walk import assert_close
from vo_service.odometry.keyframe.alignment import (
    STANDING,
    Alignment,
    align,
    all_alike,
    depth_alone,
    look_at,
    start_fit,
)
from vo_service.odometry.keyframe.cells import ALL_STILL, CELL_COLUMNS, CELL_ROWS
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.movement import at_rest
from vo_service.odometry.keyframe.points import find_points
from vo_service.odometry.keyframe.readings import BRIGHTNESS, CELL, DEPTH, HIDDEN, OTHER
from vo_service.odometry.keyframe.regions import weigh_regions
from vo_service.odometry.keyframe.system import SIGMA_BRIGHTNESS, SIGMA_DEPTH

FRAME = noisy(seen(), 0)
POINTS = find_points(make_images(FRAME), at_rest(), ALL_STILL)
# Rows and columns of cells.
PATCH = (slice(2, 4), slice(3, 6))
OTHER_WAY = Hand(np.array([-0.6, 0.5, -1.0, 0.0, 0.0, 0.0]))


def with_a_mover(frame: RgbdFrame, other: RgbdFrame) -> RgbdFrame:
    """A patch of the view shows what another camera sees there."""
    rows, columns = PATCH
    height, width = (
        a // b for a, b in zip(frame.grey.shape, (CELL_ROWS, CELL_COLUMNS), strict=True)
    )
    within = np.s_[
        rows.start * height : rows.stop * height, columns.start * width : columns.stop * width
    ]
    colour, depth = frame.colour_bgr.copy(), frame.depth_raw.copy()
    colour[within], depth[within] = other.colour_bgr[within], other.depth_raw[within]
    return replace(frame, colour_bgr=colour, depth_raw=depth)


def laid_on(frame: RgbdFrame, weights: Array) -> Alignment:
    return align(POINTS, make_images(frame), [np.eye(4)], STANDING.loosened(), (1.0, 0.0), weights)


def in_patch(weights: Array) -> tuple[Array, Array]:
    """Weights of depth inside of the patch, and outside."""
    grid = weights[1].reshape(CELL_ROWS, CELL_COLUMNS)
    patch = np.zeros(grid.shape, np.bool_)
    patch[PATCH] = True
    return grid[patch], grid[~patch]


def test_a_patch_that_moves_by_itself_counts_little_and_the_motion_stays_right() -> None:
    here, there = seen(BRISK, 0.1), seen(OTHER_WAY, 0.1)
    found = laid_on(noisy(with_a_mover(here, there), 1), all_alike())
    inside, outside = in_patch(found.weights)
    assert inside.max() < 0.5
    assert np.median(outside) == 1.0
    assert np.mean(outside > 0.5) > 0.9
    assert not found.is_still.reshape(CELL_ROWS, CELL_COLUMNS)[PATCH].any()
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.1), 0.002, 0.05)


def test_where_nothing_moves_by_itself_all_regions_count() -> None:
    found = laid_on(noisy(seen(BRISK, 0.1), 1), all_alike())
    assert found.is_still.mean() > 0.95
    assert found.weights.mean() > 0.95


def test_what_does_not_count_from_the_start_still_does_not() -> None:
    found = laid_on(noisy(seen(BRISK, 0.1), 1), depth_alone())
    assert not found.weights[0].any()
    assert found.weights[1].mean() > 0.95
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.1), 0.002, 0.05)


def readings_at_rest() -> tuple[Array, Array]:
    fit = start_fit()
    fit[SIGMA_BRIGHTNESS], fit[SIGMA_DEPTH] = 3.0, 1e-3
    return look_at(POINTS, make_images(noisy(seen(), 1)), np.eye(4), at_rest(), 0), fit


@pytest.mark.parametrize("worse_by", [15.0, 60.0, 120.0])
def test_a_cell_counts_the_less_the_worse_it_fits(worse_by: float) -> None:
    readings, fit = readings_at_rest()
    before = weigh_regions(POINTS[0], readings, fit, all_alike())
    odd = readings[:, CELL] == 20
    readings[odd, BRIGHTNESS] += np.where(np.arange(odd.sum()) % 2, worse_by, 0.0)
    after = weigh_regions(POINTS[0], readings, fit, all_alike())
    assert after[0, 20] == after[1, 20] < 0.5 < before[0, 20]
    others = np.arange(len(after[0])) != 20
    np.testing.assert_allclose(after[:, others], before[:, others], rtol=0.1)


@pytest.mark.parametrize(("sign", "is_lowered"), [(-HIDDEN, True), (HIDDEN, False)])
def test_a_cell_that_is_seen_through_counts_less_one_that_is_hidden_a_little_does_not(
    sign: float, is_lowered: bool
) -> None:
    readings, fit = readings_at_rest()
    (in_cell,) = np.nonzero(readings[:, CELL] == 20)
    odd = in_cell[::3]
    readings[odd, OTHER] = sign
    readings[odd, BRIGHTNESS] = readings[odd, DEPTH] = np.nan
    weights = weigh_regions(POINTS[0], readings, fit, all_alike())
    assert (weights[1, 20] < 0.9) == is_lowered


def test_with_nothing_to_judge_by_all_weights_stay() -> None:
    readings, fit = readings_at_rest()
    readings[:, CELL] = -1.0
    np.testing.assert_array_equal(weigh_regions(POINTS[0], readings, fit, all_alike()), all_alike())
