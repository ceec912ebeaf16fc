"""Contradiction of two depth images by a motion."""

import numpy as np
import pytest

from drivers.core.geometry import Array, rigid_transform
from tests.vo_service.odometry.synthetic_views import CAMERA
from vo_service.odometry.depth_grid import NO_DEPTH, DepthGrid

SHAPE = (CAMERA.height, CAMERA.width)
AT_REST = np.eye(4)


def make_wall(depth_m: float) -> DepthGrid:
    return DepthGrid.of(np.full(SHAPE, depth_m, np.float32), CAMERA)


def make_post(depth_m: float, left_px: int) -> DepthGrid:
    """A wall at 3 m, and a post of a quarter of the image before it."""
    image_m = np.full(SHAPE, 3.0, np.float32)
    image_m[:, left_px : left_px + 80] = depth_m
    return DepthGrid.of(image_m, CAMERA)


def forward(distance_m: float) -> Array:
    return rigid_transform(np.eye(3), [0.0, 0.0, distance_m])


def test_the_true_motion_contradicts_nothing() -> None:
    assert make_wall(2.0).contradiction(make_wall(2.5), forward(0.5)) == 0.0


@pytest.mark.parametrize("distance_m", [0.0, 1.0])
def test_a_wrong_motion_along_the_ray_contradicts_everything(distance_m: float) -> None:
    # One of both cameras saw through the wall, whichever way the motion is wrong.
    assert make_wall(2.0).contradiction(make_wall(2.5), forward(distance_m)) == 1.0


def test_noise_is_no_contradiction() -> None:
    assert make_wall(2.0).contradiction(make_wall(2.05), AT_REST) == 0.0


def test_what_is_seen_through_counts_and_what_is_occluded_does_not() -> None:
    # The post is at other places: a quarter of what either camera sees is occluded in the other.
    share = make_post(1.0, 0).contradiction(make_post(1.0, 160), AT_REST)
    assert share == pytest.approx(1 / 3, abs=0.02)


def test_without_common_depth_there_is_no_contradiction() -> None:
    assert make_wall(2.0).contradiction(make_wall(0.0), AT_REST) == 0.0
    assert make_wall(2.0).contradiction(NO_DEPTH, AT_REST) == 0.0
    assert make_wall(2.0).contradiction(make_wall(2.0), forward(-5.0)) == 0.0
