"""Warping of a keyframe's points into a frame with a rolling shutter."""

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
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    CELL_COLUMNS,
    CELL_ROWS,
    build_image_pyramid,
)
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.points import Points, select_points
from vo_service.odometry.direct.samples import Samples, empty_samples, warp_and_sample

STANDING = zero_motion()
POINTS = select_points(build_image_pyramid(render_view()), STANDING, ALL_STATIC)[0]
AWAY = series_exponential(np.array([0.05, -0.03, 0.08, 0.04, -0.05, 0.06]))


def sample_view(
    frame: RgbdFrame,
    T_camera_keyframe: Array,
    camera_motion: Array,
    points: Points = POINTS,
    vignetting: float = 0.0,
) -> Samples:
    images = build_image_pyramid(frame, vignetting)
    samples = empty_samples(len(points.brightness))
    warp_and_sample(points, images.levels[0], T_camera_keyframe, camera_motion, samples)
    return samples


def pixels(samples: Samples) -> Array:
    """(N, 2) u and v."""
    return np.stack([samples.u, samples.v], axis=1)


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
def test_every_point_is_sampled_at_the_time_of_its_row(readout_s: float, skew_s: float) -> None:
    frame = replace(render_view(), readout_s=readout_s, skew_s=skew_s)
    samples = sample_view(frame, AWAY, BRISK.motion)
    in_view = samples.u >= 0
    assert in_view.sum() > 500
    places = transform_points(AWAY, POINTS.position_m.T[in_view])
    exact = [slowly(place, BRISK.velocity, readout_s, 0.0) for place in places[::10]]
    np.testing.assert_allclose(pixels(samples)[in_view][::10], np.array(exact)[:, :2], atol=0.02)


@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.0, 0.0), (0.03, 0.0), (0.02, -0.015)])
def test_a_rolling_shutter_view_samples_the_keyframe_brightness(
    readout_s: float, skew_s: float
) -> None:
    """With the true motion the residuals are small, though every row has its own pose."""
    frame = render_view(BRISK, 0.2, readout_s=readout_s, skew_s=skew_s)
    samples = sample_view(frame, inverse(BRISK.pose_at(0.2)), BRISK.motion)
    brightness = samples.brightness - POINTS.brightness
    assert np.isfinite(brightness).mean() > 0.7
    assert np.nanmedian(np.abs(brightness)) < 1.0
    assert np.nanmedian(np.abs(samples.depth_residual)) < 5e-5
    if readout_s:
        without = sample_view(frame, inverse(BRISK.pose_at(0.2)), STANDING)
        assert np.nanmedian(np.abs(without.depth_residual)) > 1e-4


def test_a_trembling_view_samples_the_keyframe_brightness() -> None:
    frame = render_view(SHAKING, readout_s=0.03, skew_s=0.01)
    with_timing, without_timing = (
        sample_view(frame, np.eye(4), hand.motion).depth_residual for hand in (SHAKING, BRISK)
    )
    assert np.nanmedian(np.abs(with_timing)) < 5e-5
    assert np.nanmedian(np.abs(without_timing)) > 3 * np.nanmedian(np.abs(with_timing))


def test_depth_is_sampled_later_by_the_skew() -> None:
    """A camera that moves forward: later depth is smaller."""
    forward = MovingCamera(np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0]))
    points = select_points(build_image_pyramid(render_view(planes=(WALL,))), STANDING, ALL_STATIC)[
        0
    ]
    frame = render_view(forward, planes=(WALL,), skew_s=0.02)
    with_timing = sample_view(frame, np.eye(4), forward.motion, points)
    without_timing = sample_view(replace(frame, skew_s=0.0), np.eye(4), forward.motion, points)
    assert np.nanmax(np.abs(with_timing.depth_residual)) < 1e-4
    # Closer by 12 mm at 2.2 m.
    assert np.nanmedian(without_timing.depth_residual) == pytest.approx(0.012 / 2.2**2, rel=0.1)


def test_each_sample_has_its_cell_and_band() -> None:
    samples = sample_view(render_view(), np.eye(4), STANDING)
    is_read = samples.cell >= 0
    rows = samples.v[is_read] / CAMERA.height
    cells = np.floor(rows * CELL_ROWS) * CELL_COLUMNS
    cells += np.floor(samples.u[is_read] / CAMERA.width * CELL_COLUMNS)
    np.testing.assert_array_equal(samples.cell[is_read], cells)
    assert np.all(np.diff(samples.color_band[is_read][np.argsort(rows)]) >= 0)
    np.testing.assert_array_equal(samples.color_band[is_read], samples.depth_band[is_read])


def test_points_outside_the_image_or_behind_the_camera_have_no_sample() -> None:
    aside = series_exponential(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    samples = sample_view(render_view(), aside, STANDING)
    gone = samples.cell < 0
    places = transform_points(aside, POINTS.position_m.T)
    assert np.all(gone[CAMERA.fx * places[:, 0] / places[:, 2] + CAMERA.cx > CAMERA.width])
    assert 0 < gone.sum() < len(gone)
    behind = sample_view(
        render_view(), series_exponential(np.array([0, 0, 0, 0, np.pi, 0])), STANDING
    )
    assert np.all(behind.cell == -1)
    for unread, which in ((samples, gone), (behind, ...)):
        assert np.isnan(unread.brightness[which]).all()
        assert np.isnan(unread.depth_residual[which]).all()


@pytest.mark.parametrize(("times", "sign"), [(0.7, 1), (1.6, -1)])
def test_another_surface_occludes_a_point_or_is_behind_it(times: float, sign: int) -> None:
    frame = render_view(planes=(WALL,))
    depth_raw = frame.depth_raw.copy()
    depth_raw[60:180, 80:240] = (depth_raw[60:180, 80:240] * times).astype(np.uint16)
    points = select_points(build_image_pyramid(frame), STANDING, ALL_STATIC)[0]
    samples = sample_view(replace(frame, depth_raw=depth_raw), np.eye(4), STANDING, points)
    within = (np.abs(samples.u - 159.5) < 78) & (np.abs(samples.v - 119.5) < 58)
    assert within.sum() > 100
    assert np.all(samples.occlusion[within] == sign)
    assert np.isnan(samples.brightness[within]).all()
    assert np.isnan(samples.depth_residual[within]).all()
    beyond = (np.abs(samples.u - 159.5) > 82) | (np.abs(samples.v - 119.5) > 62)
    assert not samples.occlusion[beyond].any()


def test_without_depth_brightness_is_still_sampled() -> None:
    frame = render_view()
    samples = sample_view(replace(frame, depth_raw=0 * frame.depth_raw), np.eye(4), STANDING)
    is_read = samples.cell >= 0
    assert is_read.any()
    assert np.isnan(samples.depth_residual).all()
    assert np.isfinite(samples.brightness[is_read]).all()
    assert not samples.occlusion.any()


def test_vignetting_is_corrected_towards_the_corner() -> None:
    plain = sample_view(render_view(), AWAY, STANDING)
    with_timing = sample_view(render_view(), AWAY, STANDING, vignetting=0.2)
    is_visible = ~np.isnan(plain.brightness)
    center, focal_px = [CAMERA.cx, CAMERA.cy], CAMERA.fx
    now = (((pixels(plain)[is_visible] - center) / focal_px) ** 2).sum(axis=1)
    x, y, z = POINTS.position_m[:, is_visible]
    before = (x / z) ** 2 + (y / z) ** 2
    expected = plain.brightness[is_visible] * (1.0 + 0.2 * (now - before))
    np.testing.assert_allclose(with_timing.brightness[is_visible], expected, rtol=1e-9)
