from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import inverse, transform_points
from drivers.plausibility import PlausibilityCheck
from drivers.synthetic.config import ColorSensorModel, MotionKind, ShutterTiming, SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import Renderer, make_renderer
from drivers.synthetic.room import ROOM_HEIGHT_M
from tests.drivers.synthetic.conftest import FAULTY, IDEAL
from vo_service.config import read_config

pytestmark = pytest.mark.slow

FREIBURG1 = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
Shoot = Callable[[SyntheticConfig], Renderer]
SEQUENCES = sorted((Path(__file__).parents[3] / "config/sequences").glob("*.toml"))
LARGER = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)


def test_another_seed_is_another_room(shared_renderer: Shoot) -> None:
    other = make_renderer(replace(IDEAL, seed=2), 2)
    a, b = shared_renderer(IDEAL).render(0), other.render(0)
    assert np.mean(a.depth_raw == b.depth_raw) < 0.1
    assert np.mean(cv2.absdiff(a.color_bgr, b.color_bgr)) > 10


def test_points_seen_in_two_ideal_frames_agree(shared_renderer: Shoot) -> None:
    """Corners projected by depth and true poses, compared with optical flow."""
    config = replace(IDEAL, camera=LARGER, rate_hz=10.0, duration_s=1.0)
    renderer = shared_renderer(config)
    one, two = renderer.render(0), renderer.render(1)
    gray = [cv2.cvtColor(images.color_bgr, cv2.COLOR_BGR2GRAY) for images in (one, two)]
    corners = cv2.goodFeaturesToTrack(gray[0], 150, 0.05, 8)
    found, ok, _ = cv2.calcOpticalFlowPyrLK(gray[0], gray[1], corners, corners + 0.0)
    u, v = np.rint(corners[:, 0]).astype(int).T
    z = one.depth_raw[v, u] / config.depth_factor
    rays = (corners[:, 0] - (LARGER.cx, LARGER.cy)) / (LARGER.fx, LARGER.fy)
    poses = make_motion(config, ROOM_HEIGHT_M).poses(np.array([0.0, 0.1]))
    points = np.column_stack([rays * z[:, None], z])
    moved = transform_points(inverse(poses[1]) @ poses[0], points)
    expected = moved[:, :2] / moved[:, 2:] * LARGER.fx + (LARGER.cx, LARGER.cy)
    error_px = np.linalg.norm(expected - found[:, 0], axis=1)[ok.ravel() == 1]
    assert np.linalg.norm(expected - corners[:, 0], axis=1).mean() > 1.0
    assert np.median(error_px) < 0.12
    column, row = np.rint(expected).astype(int).T
    inside = (column >= 0) & (column < 320) & (row >= 0) & (row < 240)
    depth_error_m = (
        two.depth_raw[row[inside], column[inside]] / config.depth_factor - moved[inside, 2]
    )
    assert np.median(np.abs(depth_error_m)) < 0.004


def test_each_row_of_a_rolling_shutter_is_seen_at_its_own_instant(shared_renderer: Shoot) -> None:
    """Row r of 96 is the same row of a global shutter r - 47.5 row times after the stamp."""
    readout_s = 0.019
    per_row = replace(IDEAL, rate_hz=2 * 95 / readout_s)
    rolling = replace(IDEAL, rate_hz=10.0, timing=ShutterTiming(readout_s=readout_s, skew_s=0.0))
    rolled, whole = shared_renderer(rolling).render(1), shared_renderer(per_row)
    middle = round(0.1 * per_row.rate_hz)
    for row in (0, 30, 95):
        instant = whole.render(middle + 2 * row - 95)
        np.testing.assert_allclose(rolled.depth_raw[row] * 1.0, instant.depth_raw[row], atol=1)
        assert np.mean(cv2.absdiff(rolled.color_bgr[row], instant.color_bgr[row])) < 0.2
    assert np.any(rolled.depth_raw[0] != whole.render(middle).depth_raw[0])


def test_depth_is_taken_later_than_color_by_the_skew(shared_renderer: Shoot) -> None:
    at_once = replace(IDEAL, rate_hz=100.0)
    skewed = replace(at_once, rate_hz=50.0, timing=ShutterTiming(readout_s=0.0, skew_s=0.01))
    together, apart = shared_renderer(at_once), shared_renderer(skewed)
    np.testing.assert_array_equal(apart.render(1).color_bgr, together.render(2).color_bgr)
    np.testing.assert_allclose(
        apart.render(1).depth_raw * 1.0, together.render(3).depth_raw, atol=1
    )


def test_distortion_is_rendered_and_removed_again(shared_renderer: Shoot) -> None:
    distorted = replace(IDEAL, camera=LARGER, color=replace(IDEAL.color, distortion=FREIBURG1))
    pinhole, lens = (
        shared_renderer(c).render(0) for c in (replace(IDEAL, camera=LARGER), distorted)
    )
    seen = lens.depth_raw > 0
    assert seen.mean() > 0.9
    difference_m = np.abs(pinhole.depth_raw[seen] / 5000.0 - lens.depth_raw[seen] / 5000.0)
    assert np.median(difference_m) < 0.002
    assert np.mean(difference_m > 0.05) < 0.02
    assert np.median(cv2.absdiff(pinhole.color_bgr, lens.color_bgr)[seen]) <= 2


def test_the_kinect_s_depth_has_shadows_borders_and_steps(shared_renderer: Shoot) -> None:
    depth = shared_renderer(replace(FAULTY, camera=LARGER)).render(0).depth_raw
    holes = depth == 0
    assert 0.1 < holes.mean() < 0.5
    assert holes[:, :3].all()
    assert len(np.unique(depth)) < 900
    assert depth.max() <= 5000
    assert depth[~holes].min() >= 500


def test_standing_still_shows_the_same_scene(shared_renderer: Shoot) -> None:
    steady = replace(FAULTY.color, gain_drift=0.0)
    renderer = shared_renderer(replace(FAULTY, motion=MotionKind.STILL, color=steady))
    a, b = renderer.render(0).color_bgr, renderer.render(5).color_bgr
    assert 0 < np.mean(cv2.absdiff(a, b)) < 6


def test_every_fault_of_the_sensor_can_be_switched_off_alone(shared_renderer: Shoot) -> None:
    """Changing any one number changes the frames."""
    once = replace(FAULTY, camera=LARGER)
    eye, depth = once.color, once.depth
    variants = [
        replace(once, color=ColorSensorModel(**{**vars(eye), key: value}))
        for key, value in (
            ("distortion", (0.0,) * 5),
            ("noise_sigma", 0.0),
            ("softness_px", 0.0),
            ("exposure_s", 0.0),
            ("gain_drift", 0.0),
            ("vignetting", 0.0),
            ("smooth_edges", False),
        )
    ] + [
        replace(once, depth=replace(depth, registration=False)),
        replace(once, depth=replace(depth, eye_offset_m=0.0)),
        replace(once, depth=replace(depth, shadows=False)),
        replace(once, depth=replace(depth, disparity_step_px=0.0)),
        replace(once, depth=replace(depth, disparity_sigma_px=0.0)),
        replace(once, depth=replace(depth, lateral_sigma_px=0.0)),
        replace(once, depth=replace(depth, max_range_m=2.0)),
        replace(once, timing=ShutterTiming(readout_s=0.0)),
        replace(once, timing=ShutterTiming(skew_s=0.0)),
    ]
    frames = [shared_renderer(variant).render(0) for variant in [once, *variants]]
    seen = {frame.color_bgr.tobytes() + frame.depth_raw.tobytes() for frame in frames}
    assert len(seen) == len(variants) + 1


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("seed", [1, 2])
def test_the_camera_stays_clear_of_the_furniture(seed: int) -> None:
    config = replace(IDEAL, seed=seed, duration_s=20.0, rate_hz=0.25)
    renderer = make_renderer(config, 2)
    assert min(renderer.render(i).depth_raw.min() for i in range(5)) > 0.2 * 5000


class VirtualOrigin:
    """What the plausibility check asks a camera for."""

    name = intrinsics_source = depth_unit_source = "synthetic"


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("file", SEQUENCES, ids=lambda file: file.stem)
def test_the_depth_of_every_sequence_is_plausible(file: Path) -> None:
    whole = read_config(file).synthetic
    config = replace(whole, rate_hz=2.1 / whole.duration_s)
    renderer, check = make_renderer(config, 2), PlausibilityCheck(VirtualOrigin())
    for index in range(config.frame_count):
        images = renderer.render(index)
        pixels = images.color_bgr, images.depth_raw
        check.examine(RgbdFrame(index, 0.0, 0.0, *pixels, config.depth_factor, config.camera))
    assert config.frame_count >= 2
    assert check.warning == ""
