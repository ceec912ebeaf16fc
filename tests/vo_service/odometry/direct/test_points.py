"""Selection of a keyframe's points: positions and times."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array, transform_points
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CAMERA,
    CORNER,
    SHAKING,
    WALL,
    add_noise,
    render_view,
    texture_at,
)
from vo_service.odometry.direct.alignment import STATIC_PRIOR, align, uniform_weights
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    CELL_COLUMNS,
    CELL_ROWS,
    NUM_CELLS,
    build_image_pyramid,
)
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.keyframe_correction import correct_keyframe
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.points import (
    Points,
    drop_empty_levels,
    select_points,
)
from vo_service.odometry.direct.quality import rejection_reason

STANDING = zero_motion()


def off_planes_m(places: Array) -> Array:
    """(N,) distance of positions in the world frame from the nearest plane of the corner."""
    off = [np.abs(places @ n - d) / np.linalg.norm(n) for n, d in CORNER]
    return np.asarray(np.min(off, axis=0))


def off_wall_m(places: Array) -> Array:
    """(N,) distance of positions in the world frame from the wall."""
    off: Array = np.abs(places @ WALL[0] - WALL[1]) / np.linalg.norm(WALL[0])
    return off


def off_paint(points: Points) -> float:
    """Mean error of the points' brightness, gray levels."""
    return float(np.abs(points.brightness - texture_at(points.position_m.T)).mean())


def pixels(points: Points) -> tuple[Array, Array]:
    """(N,) columns and rows of points in the keyframe's image."""
    x, y, z = points.position_m
    return CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy


def test_every_level_has_points_over_the_whole_view() -> None:
    for points in select_points(build_image_pyramid(render_view()), STANDING, ALL_STATIC):
        u, v = pixels(points)
        assert u.min() < 60 < 260 < u.max()
        assert v.min() < 60 < 180 < v.max()


def test_points_lie_on_the_surfaces_and_noise_is_averaged() -> None:
    for points in select_points(build_image_pyramid(render_view()), STANDING, ALL_STATIC):
        has_shape = points.select(points.has_shape)
        # Where two of the planes meet, the one that is fitted lies between them.
        assert np.median(off_planes_m(has_shape.position_m.T)) < 1e-4
    points = select_points(build_image_pyramid(add_noise(render_view(), 1)), STANDING, ALL_STATIC)[
        0
    ]
    z = points.position_m[2]
    of_one_reading_m = 8e-4 * z * z
    errors = off_planes_m(points.position_m.T) / of_one_reading_m
    assert np.median(errors[points.has_shape]) < 0.25


def test_brightness_and_its_gradient_are_those_of_the_texture() -> None:
    points = select_points(build_image_pyramid(render_view()), STANDING, ALL_STATIC)[0]
    places = points.position_m.T
    assert np.abs(points.brightness - texture_at(places)).mean() < 2.0
    # Sideways, along a wall that faces the camera, brightness changes as it is painted.
    step = np.array([2e-3, 0.0, -2e-4])
    on_wall = np.abs(places @ WALL[0] - WALL[1]) < 1e-3
    predicted = step @ points.brightness_gradient
    true = texture_at(places) - texture_at(places - step)
    strong = on_wall & points.has_texture
    # The camera's pixel goes with the point: what it meets is the paint further on.
    assert np.corrcoef(predicted[strong], true[strong])[0, 1] > 0.95


def test_the_depth_gradient_is_that_of_the_plane() -> None:
    points = select_points(build_image_pyramid(render_view(planes=(WALL,))), STANDING, ALL_STATIC)[
        0
    ]
    normal, distance = np.array(WALL[0]), WALL[1]
    step = np.array([1e-3, -2e-3, 1.5e-3])
    moved = points.position_m.T + step
    # 1/z of the wall where the moved point is seen, less that of the moved point.
    rays = moved / moved[:, 2:]
    difference = rays @ normal / distance - 1.0 / moved[:, 2]
    predicted = step @ points.depth_gradient
    np.testing.assert_allclose(predicted, difference, atol=1e-5)


def test_a_pixel_beside_a_depth_edge_is_no_point() -> None:
    frame = render_view(planes=(WALL,))
    depth_raw = frame.depth_raw.copy()
    depth_raw[:, 160:] = 6000
    points = select_points(
        build_image_pyramid(replace(frame, depth_raw=depth_raw)), STANDING, ALL_STATIC
    )[0]
    u, _ = pixels(points)
    assert not np.any(np.abs(u - 159.5) < 1.5)
    assert np.any(u < 155)
    assert np.any(u > 165)


def test_no_points_are_taken_from_cells_that_move() -> None:
    is_static = np.ones(NUM_CELLS, np.bool_).reshape(CELL_ROWS, CELL_COLUMNS)
    is_static[:, : CELL_COLUMNS // 2] = False
    for points in select_points(build_image_pyramid(render_view()), STANDING, is_static.ravel()):
        assert np.all(points.position_m[0] > -0.02 * points.position_m[2])


def test_without_texture_points_are_selected_by_shape() -> None:
    for points in select_points(build_image_pyramid(render_view(paint=0.0)), STANDING, ALL_STATIC):
        assert len(points.brightness) > 50
        assert not points.has_texture.any()
        assert points.has_shape.all()


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.03, 0.0), (0.0, 0.015), (0.025, -0.012)])
def test_rows_of_a_rolling_shutter_are_moved_to_the_stamp(
    level: int, readout_s: float, skew_s: float
) -> None:
    frame = render_view(BRISK, planes=(WALL,), readout_s=readout_s, skew_s=skew_s)
    images, instant = build_image_pyramid(frame), build_image_pyramid(render_view(planes=(WALL,)))
    points = select_points(images, BRISK.motion, ALL_STATIC)[level]
    left = select_points(images, STANDING, ALL_STATIC)[level]
    assert off_wall_m(points.position_m.T).max() < 3e-4
    assert off_paint(points) < 1.1 * off_paint(select_points(instant, STANDING, ALL_STATIC)[level])
    # Left as they are they are off by as much as the camera moved meanwhile.
    assert off_wall_m(left.position_m.T).max() > 2e-3
    assert off_paint(left) > off_paint(points)


@pytest.mark.parametrize("skew_s", [-0.012, 0.0, 0.012])
def test_rows_distorted_by_a_tremor_are_corrected(skew_s: float) -> None:
    images = build_image_pyramid(
        render_view(SHAKING, planes=(WALL,), readout_s=0.03, skew_s=skew_s)
    )
    straight = select_points(images, SHAKING.motion, ALL_STATIC)[0]
    bent = select_points(images, BRISK.motion, ALL_STATIC)[0]
    assert off_wall_m(straight.position_m.T).max() < 4e-4
    assert off_paint(straight) < 0.8 * off_paint(bent)


def test_the_points_of_a_rolling_shutter_image_are_in_the_camera_axes_at_its_stamp() -> None:
    stamp_s = 0.4
    frame = render_view(BRISK, stamp_s, readout_s=0.03, skew_s=0.01)
    points = select_points(build_image_pyramid(frame), BRISK.motion, ALL_STATIC)[0]
    places = transform_points(BRISK.pose_at(stamp_s), points.position_m.T)
    assert np.percentile(off_planes_m(places), 80) < 3e-4


def test_with_a_global_shutter_the_velocity_does_not_matter() -> None:
    images = build_image_pyramid(render_view())
    for standing, moving in zip(
        select_points(images, STANDING, ALL_STATIC),
        select_points(images, BRISK.motion, ALL_STATIC),
        strict=True,
    ):
        for field, of_moving in zip(standing, moving, strict=True):
            np.testing.assert_array_equal(field, of_moving)


@pytest.mark.parametrize(("counts", "kept"), [((9, 1, 0, 3), [9, 1]), ((0, 4, 3, 3), [0])])
def test_levels_from_an_empty_one_on_are_dropped(counts: tuple[int, ...], kept: list[int]) -> None:
    images = build_image_pyramid(render_view())
    levels = select_points(images, STANDING, ALL_STATIC)
    points = drop_empty_levels(
        level.select(slice(count)) for level, count in zip(levels, counts, strict=True)
    )
    assert [len(level.brightness) for level in points] == kept
    alignment = align(points, images, np.eye(4), STATIC_PRIOR, 1.0, uniform_weights())
    assert (
        rejection_reason(alignment)
        == f"only {kept[0]} of {kept[0]} points of the keyframe are in view"
    )


def test_where_little_of_the_view_has_depth_the_points_are_closer_together() -> None:
    frame = render_view()
    depth_raw = np.zeros_like(frame.depth_raw)
    depth_raw[100:150, 120:190] = frame.depth_raw[100:150, 120:190]
    all_points, points = (
        select_points(build_image_pyramid(each), STANDING, ALL_STATIC)[0]
        for each in (frame, replace(frame, depth_raw=depth_raw))
    )
    u, v = pixels(all_points)
    in_same_area = (u >= 120) & (u < 190) & (v >= 100) & (v < 150)
    assert len(points.brightness) > 1.5 * np.count_nonzero(in_same_area)


@pytest.mark.parametrize("stride", [1, 4])
def test_levels_of_few_points_are_aligned(stride: int) -> None:
    frame = render_view()
    depth_raw = np.zeros_like(frame.depth_raw)
    depth_raw[100:128, 150:178] = frame.depth_raw[100:128, 150:178]
    images = build_image_pyramid(replace(frame, depth_raw=depth_raw))
    keyframe = make_keyframe(frame, images, np.eye(4), STANDING, ALL_STATIC)
    assert [len(points.brightness) for points in keyframe.points] == [36, 8, 2, 4]
    shutter = images.shutter
    keyframe = correct_keyframe(keyframe, images.camera, shutter, STANDING, stride)
    counts = [len(points.brightness) for points in keyframe.points]
    assert counts == ([36, 8, 2, 4] if stride == 1 else [9, 2, 1, 1])
    align(keyframe.points, images, np.eye(4), STATIC_PRIOR, 1.0, uniform_weights())
