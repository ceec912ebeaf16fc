"""A keyframe is corrected to where another calibration sees its points."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array
from tests.vo_service.odometry.direct.rolling_shutter_views import add_noise, render_view
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    ImageTiming,
    build_image_pyramid,
)
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.keyframe_correction import correct_camera, correct_keyframe
from vo_service.odometry.direct.motion import zero_motion

MOTION = np.array([0.3, 0.1, 0.2, 0.5, 0.3, 0.2, 0.0, 0.0, 0.0])


def keyframe_with(shutter: ImageTiming, motion: Array, focal: float = 0.0) -> DirectKeyframe:
    frame = add_noise(render_view(), 1)
    camera = correct_camera(frame.camera, np.array([0.0, 0.0, focal]))
    images = replace(build_image_pyramid(frame), shutter=shutter, camera=camera)
    return make_keyframe(frame, images, np.eye(4), motion, ALL_STATIC)


def difference(one: DirectKeyframe, other: DirectKeyframe) -> Array:
    """(N,) distances of the finest points of one from the nearest ones of the other, m."""
    return np.array(
        [
            np.linalg.norm(other.points[0].position_m.T - position_m, axis=1).min()
            for position_m in one.points[0].position_m.T
        ]
    )


@pytest.mark.parametrize(
    ("shutter", "focal"),
    [
        (ImageTiming(0.030, 0.0), 0.0),
        (ImageTiming(0.0, 0.008), 0.0),
        (ImageTiming(0.020, -0.008), 0.0),
        (ImageTiming(0.0, 0.0), 0.02),
    ],
)
def test_a_corrected_keyframe_is_nearly_that_which_is_made_anew(
    shutter: ImageTiming, focal: float
) -> None:
    old = keyframe_with(ImageTiming(0.0, 0.0), zero_motion())
    new = keyframe_with(shutter, MOTION, focal)
    corrected = correct_keyframe(old, new.images.camera, shutter, MOTION)
    assert np.median(difference(corrected, new)) < 0.2 * np.median(difference(old, new))


def test_a_correction_can_be_taken_back() -> None:
    old = keyframe_with(ImageTiming(0.010, 0.002), MOTION)
    there = correct_keyframe(old, old.images.camera, ImageTiming(0.020, 0.008), 0.5 * MOTION)
    back = correct_keyframe(there, old.images.camera, old.images.shutter, MOTION)
    np.testing.assert_allclose(back.points[0].position_m, old.points[0].position_m, atol=2e-3)


def test_sparse_points_are_some_of_all() -> None:
    old = keyframe_with(ImageTiming(0.0, 0.0), zero_motion())
    sparse = correct_keyframe(old, old.images.camera, old.images.shutter, old.motion, 4)
    position_m, *fields = sparse.points[0]
    expected_m, *expected = old.points[0].select(slice(None, None, 4))
    np.testing.assert_allclose(position_m, expected_m, atol=1e-12)
    for field, of_old in zip(fields, expected, strict=True):
        np.testing.assert_array_equal(field, of_old)
