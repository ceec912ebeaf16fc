"""Where a keyframe's points come to lie in a frame whose rows are of different times."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse, transform_points
from tests.vo_service.odometry.keyframe.rolling_views import (
    BRISK,
    CAMERA,
    TREMBLING,
    WALL,
    Hand,
    seen,
    series_exponential,
)
from vo_service.odometry.keyframe.cells import ALL_STILL, CELL_COLUMNS, CELL_ROWS
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.movement import at_rest
from vo_service.odometry.keyframe.points import BRIGHTNESS as POINT_BRIGHTNESS
from vo_service.odometry.keyframe.points import find_points
from vo_service.odometry.keyframe.readings import (
    BRIGHTNESS,
    CELL,
    COLOUR_BAND,
    COLUMNS,
    DEPTH,
    DEPTH_BAND,
    HIDDEN,
    OTHER,
    U,
    V,
    read_points,
)

STANDING = at_rest()
POINTS = find_points(make_images(seen()), STANDING, ALL_STILL)[0]
AWAY = series_exponential(np.array([0.05, -0.03, 0.08, 0.04, -0.05, 0.06]))


def readings_of(
    frame: RgbdFrame,
    T_camera_keyframe: Array,
    movement: Array,
    points: Array = POINTS,
    falloff: float = 0.0,
) -> Array:
    images = make_images(frame)
    readings = np.empty((len(points), COLUMNS))
    read_points(
        points,
        T_camera_keyframe,
        movement,
        images.grey[0],
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
    frame = replace(seen(), readout_s=readout_s, skew_s=skew_s)
    readings = readings_of(frame, AWAY, BRISK.movement)
    in_view = readings[:, U] >= 0
    assert in_view.sum() > 500
    places = transform_points(AWAY, POINTS[in_view, :3])
    exact = [slowly(place, BRISK.velocity, readout_s, 0.0) for place in places[::10]]
    np.testing.assert_allclose(
        readings[in_view][::10][:, [U, V]], np.array(exact)[:, :2], atol=0.02
    )


@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.0, 0.0), (0.03, 0.0), (0.02, -0.015)])
def test_a_rolling_view_reads_as_the_keyframe_does(readout_s: float, skew_s: float) -> None:
    """With the true motion and velocity little is left over, though every row has its own pose."""
    frame = seen(BRISK, 0.2, readout_s=readout_s, skew_s=skew_s)
    readings = readings_of(frame, inverse(BRISK.at(0.2)), BRISK.movement)
    brightness = readings[:, BRIGHTNESS] - POINTS[:, POINT_BRIGHTNESS]
    assert np.isfinite(brightness).mean() > 0.7
    assert np.nanmedian(np.abs(brightness)) < 1.0
    assert np.nanmedian(np.abs(readings[:, DEPTH])) < 5e-5
    if readout_s:
        without = readings_of(frame, inverse(BRISK.at(0.2)), STANDING)
        assert np.nanmedian(np.abs(without[:, DEPTH])) > 1e-4


def test_a_trembling_view_reads_as_the_keyframe_does() -> None:
    frame = seen(TREMBLING, readout_s=0.03, skew_s=0.01)
    told, untold = (
        readings_of(frame, np.eye(4), hand.movement)[:, DEPTH] for hand in (TREMBLING, BRISK)
    )
    assert np.nanmedian(np.abs(told)) < 5e-5
    assert np.nanmedian(np.abs(untold)) > 3 * np.nanmedian(np.abs(told))


def test_depth_is_late_by_the_skew() -> None:
    """A camera that comes nearer: what was taken later is nearer."""
    forward = Hand(np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0]))
    points = find_points(make_images(seen(planes=(WALL,))), STANDING, ALL_STILL)[0]
    frame = seen(forward, planes=(WALL,), skew_s=0.02)
    told = readings_of(frame, np.eye(4), forward.movement, points)
    untold = readings_of(replace(frame, skew_s=0.0), np.eye(4), forward.movement, points)
    assert np.nanmax(np.abs(told[:, DEPTH])) < 1e-4
    # Closer by 12 mm at 2.2 m.
    assert np.nanmedian(untold[:, DEPTH]) == pytest.approx(0.012 / 2.2**2, rel=0.1)


def test_each_reading_says_in_which_cell_and_band_it_is() -> None:
    readings = readings_of(seen(), np.eye(4), STANDING)
    is_read = readings[:, CELL] >= 0
    rows = readings[is_read, V] / CAMERA.height
    cells = np.floor(rows * CELL_ROWS) * CELL_COLUMNS
    cells += np.floor(readings[is_read, U] / CAMERA.width * CELL_COLUMNS)
    np.testing.assert_array_equal(readings[is_read, CELL], cells)
    assert np.all(np.diff(readings[is_read, COLOUR_BAND][np.argsort(rows)]) >= 0)
    np.testing.assert_array_equal(readings[is_read, COLOUR_BAND], readings[is_read, DEPTH_BAND])


def test_points_outside_of_the_image_or_behind_the_camera_have_no_reading() -> None:
    aside = series_exponential(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    readings = readings_of(seen(), aside, STANDING)
    gone = readings[:, CELL] < 0
    places = transform_points(aside, POINTS[:, :3])
    assert np.all(gone[CAMERA.fx * places[:, 0] / places[:, 2] + CAMERA.cx > CAMERA.width])
    assert 0 < gone.sum() < len(gone)
    behind = readings_of(seen(), series_exponential(np.array([0, 0, 0, 0, np.pi, 0])), STANDING)
    assert np.all(behind[:, CELL] == -1)
    for unread in (readings[gone], behind):
        assert np.isnan(unread[:, [BRIGHTNESS, DEPTH]]).all()


@pytest.mark.parametrize(("times", "sign"), [(0.7, HIDDEN), (1.6, -HIDDEN)])
def test_another_surface_hides_a_point_or_is_seen_through_it(times: float, sign: float) -> None:
    frame = seen(planes=(WALL,))
    depth_raw = frame.depth_raw.copy()
    depth_raw[60:180, 80:240] = (depth_raw[60:180, 80:240] * times).astype(np.uint16)
    points = find_points(make_images(frame), STANDING, ALL_STILL)[0]
    readings = readings_of(replace(frame, depth_raw=depth_raw), np.eye(4), STANDING, points)
    within = (np.abs(readings[:, U] - 159.5) < 78) & (np.abs(readings[:, V] - 119.5) < 58)
    assert within.sum() > 100
    assert np.all(readings[within, OTHER] == sign)
    assert np.isnan(readings[within][:, [BRIGHTNESS, DEPTH]]).all()
    beyond = (np.abs(readings[:, U] - 159.5) > 82) | (np.abs(readings[:, V] - 119.5) > 62)
    assert not readings[beyond, OTHER].any()


def test_without_depth_brightness_is_still_read() -> None:
    frame = seen()
    readings = readings_of(replace(frame, depth_raw=0 * frame.depth_raw), np.eye(4), STANDING)
    is_read = readings[:, CELL] >= 0
    assert is_read.any()
    assert np.isnan(readings[:, DEPTH]).all()
    assert np.isfinite(readings[is_read, BRIGHTNESS]).all()
    assert not readings[:, OTHER].any()


def test_what_comes_nearer_to_the_corner_is_told_as_bright_as_before() -> None:
    plain = readings_of(seen(), AWAY, STANDING)
    told = readings_of(seen(), AWAY, STANDING, falloff=0.2)
    there = ~np.isnan(plain[:, BRIGHTNESS])
    centre, focal_px = [CAMERA.cx, CAMERA.cy], CAMERA.fx
    now = (((plain[there][:, [U, V]] - centre) / focal_px) ** 2).sum(axis=1)
    before = ((POINTS[there, :2] / POINTS[there, 2:3]) ** 2).sum(axis=1)
    expected = plain[there, BRIGHTNESS] * (1.0 + 0.2 * (now - before))
    np.testing.assert_allclose(told[there, BRIGHTNESS], expected, rtol=1e-9)
