"""Where a keyframe's points come to lie in a frame whose rows are of different times."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, transform_points
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CAMERA,
    SHAKING,
    WALL,
    MovingCamera,
    render_view,
    series_exponential,
)
from vo_service.odometry.direct.grid import ALL_STATIC, CELL_COLUMNS, CELL_ROWS
from vo_service.odometry.direct.image_pyramid import build_image_pyramid
from vo_service.odometry.direct.keyframe_points import POINT_BRIGHTNESS as POINT_BRIGHTNESS
from vo_service.odometry.direct.keyframe_points import select_points
from vo_service.odometry.direct.rolling_shutter import zero_motion
from vo_service.odometry.direct.warping import (
    NUM_SAMPLE_COLUMNS,
    OCCLUDED,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_COLOR_BAND,
    SAMPLE_DEPTH_BAND,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_OCCLUSION,
    SAMPLE_U,
    SAMPLE_V,
    warp_and_sample,
)

STANDING = zero_motion()
POINTS = select_points(build_image_pyramid(render_view()), STANDING, ALL_STATIC)[0]
AWAY = series_exponential(np.array([0.05, -0.03, 0.08, 0.04, -0.05, 0.06]))


def readings_of(
    frame: RgbdFrame,
    T_camera_keyframe: Array,
    movement: Array,
    points: Array = POINTS,
    falloff: float = 0.0,
) -> Array:
    images = build_image_pyramid(frame)
    readings = np.empty((len(points), NUM_SAMPLE_COLUMNS))
    warp_and_sample(
        points,
        T_camera_keyframe,
        movement,
        images.gray[0],
        images.intrinsics[1],
        images.inverse_depth,
        images.intrinsics[0],
        frame.readout_s,
        frame.skew_s,
        falloff,
        readings,
    )
    return readings


def slowly(point: Array, velocity: Array, readout_s: float, late_s: float) -> Array:
    """Pixel and depth (3,) of a point in the camera's axes: each row at its own time."""
    u = v = z = 0.0
    tau_s = late_s
    for _ in range(30):
        x, y, z = transform_points(inverse(series_exponential(tau_s * velocity)), point[None])[0]
        u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
        tau_s = late_s + (v / (CAMERA.height - 1) - 0.5) * readout_s
    return np.array([u, v, z])


@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.0, 0.0), (0.03, 0.0), (0.02, -0.015)])
def test_every_point_is_looked_for_where_it_is_when_its_row_is_taken(
    readout_s: float, skew_s: float
) -> None:
    frame = replace(render_view(), readout_s=readout_s, skew_s=skew_s)
    readings = readings_of(frame, AWAY, BRISK.movement)
    in_view = readings[:, SAMPLE_U] >= 0
    assert in_view.sum() > 500
    places = transform_points(AWAY, POINTS[in_view, :3])
    exact = [slowly(place, BRISK.velocity, readout_s, 0.0) for place in places[::10]]
    np.testing.assert_allclose(
        readings[in_view][::10][:, [SAMPLE_U, SAMPLE_V]], np.array(exact)[:, :2], atol=0.02
    )


@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.0, 0.0), (0.03, 0.0), (0.02, -0.015)])
def test_a_rolling_view_reads_as_the_keyframe_does(readout_s: float, skew_s: float) -> None:
    """With the true motion and velocity little is left over, though every row has its own pose."""
    frame = render_view(BRISK, 0.2, readout_s=readout_s, skew_s=skew_s)
    readings = readings_of(frame, inverse(BRISK.pose_at(0.2)), BRISK.movement)
    brightness = readings[:, SAMPLE_BRIGHTNESS] - POINTS[:, POINT_BRIGHTNESS]
    assert np.isfinite(brightness).mean() > 0.7
    assert np.nanmedian(np.abs(brightness)) < 1.0
    assert np.nanmedian(np.abs(readings[:, SAMPLE_DEPTH_RESIDUAL])) < 5e-5
    if readout_s:
        without = readings_of(frame, inverse(BRISK.pose_at(0.2)), STANDING)
        assert np.nanmedian(np.abs(without[:, SAMPLE_DEPTH_RESIDUAL])) > 1e-4


def test_a_trembling_view_reads_as_the_keyframe_does() -> None:
    frame = render_view(SHAKING, readout_s=0.03, skew_s=0.01)
    told, untold = (
        readings_of(frame, np.eye(4), hand.movement)[:, SAMPLE_DEPTH_RESIDUAL]
        for hand in (SHAKING, BRISK)
    )
    assert np.nanmedian(np.abs(told)) < 5e-5
    assert np.nanmedian(np.abs(untold)) > 3 * np.nanmedian(np.abs(told))


def test_depth_is_late_by_the_skew() -> None:
    """A camera that comes nearer: what was taken later is nearer."""
    forward = MovingCamera(np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0]))
    points = select_points(build_image_pyramid(render_view(planes=(WALL,))), STANDING, ALL_STATIC)[
        0
    ]
    frame = render_view(forward, planes=(WALL,), skew_s=0.02)
    told = readings_of(frame, np.eye(4), forward.movement, points)
    untold = readings_of(replace(frame, skew_s=0.0), np.eye(4), forward.movement, points)
    assert np.nanmax(np.abs(told[:, SAMPLE_DEPTH_RESIDUAL])) < 1e-4
    # Closer by 12 mm at 2.2 m.
    assert np.nanmedian(untold[:, SAMPLE_DEPTH_RESIDUAL]) == pytest.approx(0.012 / 2.2**2, rel=0.1)


def test_each_reading_says_in_which_cell_and_band_it_is() -> None:
    readings = readings_of(render_view(), np.eye(4), STANDING)
    is_read = readings[:, SAMPLE_CELL] >= 0
    rows = readings[is_read, SAMPLE_V] / CAMERA.height
    cells = np.floor(rows * CELL_ROWS) * CELL_COLUMNS
    cells += np.floor(readings[is_read, SAMPLE_U] / CAMERA.width * CELL_COLUMNS)
    np.testing.assert_array_equal(readings[is_read, SAMPLE_CELL], cells)
    assert np.all(np.diff(readings[is_read, SAMPLE_COLOR_BAND][np.argsort(rows)]) >= 0)
    np.testing.assert_array_equal(
        readings[is_read, SAMPLE_COLOR_BAND], readings[is_read, SAMPLE_DEPTH_BAND]
    )


def test_points_outside_of_the_image_or_behind_the_camera_have_no_reading() -> None:
    aside = series_exponential(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    readings = readings_of(render_view(), aside, STANDING)
    gone = readings[:, SAMPLE_CELL] < 0
    places = transform_points(aside, POINTS[:, :3])
    assert np.all(gone[CAMERA.fx * places[:, 0] / places[:, 2] + CAMERA.cx > CAMERA.width])
    assert 0 < gone.sum() < len(gone)
    behind = readings_of(
        render_view(), series_exponential(np.array([0, 0, 0, 0, np.pi, 0])), STANDING
    )
    assert np.all(behind[:, SAMPLE_CELL] == -1)
    for unread in (readings[gone], behind):
        assert np.isnan(unread[:, [SAMPLE_BRIGHTNESS, SAMPLE_DEPTH_RESIDUAL]]).all()


@pytest.mark.parametrize(("times", "sign"), [(0.7, OCCLUDED), (1.6, -OCCLUDED)])
def test_another_surface_hides_a_point_or_is_seen_through_it(times: float, sign: float) -> None:
    frame = render_view(planes=(WALL,))
    depth_raw = frame.depth_raw.copy()
    depth_raw[60:180, 80:240] = (depth_raw[60:180, 80:240] * times).astype(np.uint16)
    points = select_points(build_image_pyramid(frame), STANDING, ALL_STATIC)[0]
    readings = readings_of(replace(frame, depth_raw=depth_raw), np.eye(4), STANDING, points)
    within = (np.abs(readings[:, SAMPLE_U] - 159.5) < 78) & (
        np.abs(readings[:, SAMPLE_V] - 119.5) < 58
    )
    assert within.sum() > 100
    assert np.all(readings[within, SAMPLE_OCCLUSION] == sign)
    assert np.isnan(readings[within][:, [SAMPLE_BRIGHTNESS, SAMPLE_DEPTH_RESIDUAL]]).all()
    beyond = (np.abs(readings[:, SAMPLE_U] - 159.5) > 82) | (
        np.abs(readings[:, SAMPLE_V] - 119.5) > 62
    )
    assert not readings[beyond, SAMPLE_OCCLUSION].any()


def test_without_depth_brightness_is_still_read() -> None:
    frame = render_view()
    readings = readings_of(replace(frame, depth_raw=0 * frame.depth_raw), np.eye(4), STANDING)
    is_read = readings[:, SAMPLE_CELL] >= 0
    assert is_read.any()
    assert np.isnan(readings[:, SAMPLE_DEPTH_RESIDUAL]).all()
    assert np.isfinite(readings[is_read, SAMPLE_BRIGHTNESS]).all()
    assert not readings[:, SAMPLE_OCCLUSION].any()


def test_what_comes_nearer_to_the_corner_is_told_as_bright_as_before() -> None:
    plain = readings_of(render_view(), AWAY, STANDING)
    told = readings_of(render_view(), AWAY, STANDING, falloff=0.2)
    there = ~np.isnan(plain[:, SAMPLE_BRIGHTNESS])
    centre, focal_px = [CAMERA.cx, CAMERA.cy], CAMERA.fx
    now = (((plain[there][:, [SAMPLE_U, SAMPLE_V]] - centre) / focal_px) ** 2).sum(axis=1)
    before = ((POINTS[there, :2] / POINTS[there, 2:3]) ** 2).sum(axis=1)
    expected = plain[there, SAMPLE_BRIGHTNESS] * (1.0 + 0.2 * (now - before))
    np.testing.assert_allclose(told[there, SAMPLE_BRIGHTNESS], expected, rtol=1e-9)
