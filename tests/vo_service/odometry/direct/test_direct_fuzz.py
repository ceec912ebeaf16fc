"""Any stamps, sizes and images give a valid estimate, never an error."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import PinholeCamera, RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    CAMERA,
    add_noise,
    make_empty_frame,
    make_noise_frame,
    remove_color,
    remove_depth,
    render_sequence,
    render_view,
)
from tests.vo_service.odometry.estimate_checks import assert_valid
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.registry import make_odometry

SHAPE = (CAMERA.height, CAMERA.width)


@pytest.mark.parametrize("stamps_s", [(0.0, 0.0, 0.0), (0.0, -1.0, -2.0), (0.0, 50.0, 1e6)])
@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_repeated_backward_or_jumping_stamps_are_no_error(
    stamps_s: tuple[float, ...], readout_s: float
) -> None:
    frames = render_sequence(BRISK, 3, readout_s)
    odometry = DirectOdometry()
    for k, (frame, stamp_s) in enumerate(zip(frames, stamps_s, strict=True)):
        estimate = odometry.estimate(replace(frame, stamp_s=stamp_s))
        assert_valid(estimate)
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.004, 0.2)


@pytest.mark.parametrize("size", [(32, 32), (20, 20), (7, 5), (2, 2), (200, 3)])
def test_an_image_of_a_few_pixels_gives_an_estimate(size: tuple[int, int]) -> None:
    width, height = size
    camera = PinholeCamera(width, height, width, width, width / 2 - 0.5, height / 2 - 0.5)
    for estimate in estimate_all(
        DirectOdometry(), [render_view(BRISK, k / 30, camera=camera) for k in range(3)]
    ):
        assert_valid(estimate)
        assert not estimate.ok


@pytest.mark.parametrize(("width", "height"), [(160, 120), (1280, 960), (720, 1280)])
def test_images_of_any_size_are_tracked(width: int, height: int) -> None:
    focal_px = 0.9 * width
    camera = PinholeCamera(width, height, focal_px, focal_px, width / 2 - 0.5, height / 2 - 0.5)
    odometry = make_odometry("direct", timing="fixed")
    for k in range(3):
        estimate = odometry.estimate(render_view(BRISK, k / 30, camera=camera))
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.001, 0.05)
        assert (estimate.debug.keypoints_px < [width, height]).all()
        assert estimate.debug.keypoints_px.max() > 0.9 * max(width, height)


def test_a_change_of_the_image_size_is_tracked() -> None:
    smaller = PinholeCamera(240, 180, 217.5, 217.5, 119.5, 89.5)
    cameras = [smaller, CAMERA, smaller, CAMERA]
    frames = [render_view(BRISK, k / 30, camera=camera) for k, camera in enumerate(cameras)]
    for k, estimate in enumerate(estimate_all(DirectOdometry(), frames)):
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.003, 0.1)


KINDS = st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 6))


@settings(deadline=None, max_examples=25)
@given(st.lists(KINDS, min_size=2, max_size=5), st.sampled_from([0.0, 0.02]))
def test_no_frame_raises_and_every_estimate_is_valid(
    kinds: list[tuple[int, int]], readout_s: float
) -> None:
    odometry = DirectOdometry()
    for seed, kind in kinds:
        estimate = odometry.estimate(replace(garbage(seed, kind), readout_s=readout_s))
        assert_valid(estimate)
        assert np.linalg.eigvalsh(estimate.covariance).min() >= 0


GOOD = render_sequence(BRISK, 4)


def garbage(seed: int, kind: int) -> RgbdFrame:
    """Noise, stripes, flat or no depth, a room half occluded, and the room itself."""
    random = np.random.default_rng(seed)
    frame = replace(GOOD[seed % 4], seq=seed % 50, stamp_s=(seed % 50) / 30)
    if kind == 0:
        return make_noise_frame(frame)
    if kind == 1:
        stripes = np.zeros((*SHAPE, 3), np.uint8)
        stripes[:, :: 5 + seed % 9] = 255 - seed % 256
        return replace(frame, color_bgr=stripes)
    if kind == 2:
        return replace(frame, depth_raw=np.full(SHAPE, seed % 2**16, np.uint16))
    if kind == 3:
        return (make_empty_frame, remove_color, remove_depth)[seed % 3](frame)
    if kind == 4:
        return add_noise(frame, seed, seed % 40)
    if kind == 5:
        occluded = frame.depth_raw.copy()
        occluded[:, : 10 + seed % 300] = random.integers(0, 3000)
        return replace(frame, depth_raw=occluded)
    return frame
