"""A frame laid on a keyframe: motion, velocity and light are found."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse, is_rigid, rotation_vector
from tests.vo_service.odometry.keyframe.rolling_views import (
    BRISK,
    STILL,
    TREMBLING,
    Hand,
    dark,
    lit,
    noisy,
    seen,
    without_depth,
)
from tests.vo_service.odometry.walk import assert_close
from vo_service.odometry.keyframe.alignment import (
    STANDING,
    Alignment,
    Tie,
    align,
    all_alike,
    depth_alone,
    known_within,
)
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.confidence import doubt, lack
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.movement import ACCELERATION, at_rest, in_axes
from vo_service.odometry.keyframe.points import find_points

POINTS = find_points(make_images(seen()), at_rest(), ALL_STILL)
# Nothing is known of the velocity.
LOOSE = replace(STANDING, information=np.full(9, 1e-3))


def laid(
    frame: RgbdFrame,
    tie: Tie = LOOSE,
    weights: Array | None = None,
    starts: tuple[Array, ...] = (np.eye(4),),
) -> Alignment:
    weights = all_alike() if weights is None else weights
    return align(POINTS, make_images(frame), starts, tie, (1.0, 0.0), weights)


@pytest.mark.parametrize("time_s", [0.0, 0.03, 0.12, -0.12])
def test_a_known_motion_is_found_to_a_fraction_of_a_millimetre(time_s: float) -> None:
    found = laid(seen(BRISK, time_s))
    assert is_rigid(found.T_camera_keyframe, 1e-9)
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(time_s), 0.0005, 0.01)
    assert doubt(found) == lack(found) == ""


def test_a_frame_laid_on_itself_has_not_moved() -> None:
    found = laid(seen())
    assert_close(found.T_camera_keyframe, np.eye(4), 2e-4, 5e-3)


@pytest.mark.parametrize("seed", range(3))
def test_noise_does_little(seed: int) -> None:
    found = laid(noisy(seen(BRISK, 0.1), seed))
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.1), 0.001, 0.03)


def test_the_start_that_fits_best_is_taken() -> None:
    far = Hand(4.0 * BRISK.velocity)
    wrong, right = np.eye(4), inverse(far.at(0.09))
    for starts in ((wrong, right), (right, wrong)):
        found = laid(seen(far, 0.1), starts=starts)
        assert_close(inverse(found.T_camera_keyframe), far.at(0.1), 0.001, 0.03)


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 20.0), (0.7, 0.0), (1.2, -15.0)])
def test_gain_and_offset_of_the_light_are_found(gain: float, offset: float) -> None:
    found = laid(lit(seen(BRISK, 0.05), gain, offset))
    assert found.light[0] == pytest.approx(gain, abs=0.05)
    assert found.light[1] == pytest.approx(offset, abs=6.0)
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.05), 0.0007, 0.02)


@pytest.mark.parametrize(("readout_s", "skew_s"), [(0.02, 0.01), (0.03, 0.0), (0.02, -0.012)])
def test_a_rolling_views_motion_and_velocity_are_found(readout_s: float, skew_s: float) -> None:
    found = laid(seen(BRISK, 0.1, readout_s=readout_s, skew_s=skew_s))
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.1), 0.0015, 0.05)
    np.testing.assert_allclose(found.camera_velocity, BRISK.velocity, atol=0.06)


@pytest.mark.parametrize("skew_s", [-0.012, 0.0, 0.012])
def test_a_tremor_while_rows_are_read_is_found_and_bends_no_motion(skew_s: float) -> None:
    frame = seen(TREMBLING, readout_s=0.02, skew_s=skew_s)
    steady = LOOSE.information.copy()
    steady[ACCELERATION:] = 1e6
    found, held = laid(frame), laid(frame, replace(LOOSE, information=steady))
    told_rad_s2 = found.camera_movement[ACCELERATION:]
    np.testing.assert_allclose(told_rad_s2, TREMBLING.acceleration_rad_s2, atol=3.0)
    assert not np.abs(held.camera_movement[ACCELERATION:]).max() > 1.0
    assert off_rad(found) < min(2e-4, 0.4 * off_rad(held))


def off_rad(found: Alignment) -> float:
    """How far a motion that is none is turned."""
    return float(np.linalg.norm(rotation_vector(found.T_camera_keyframe[:3, :3])))


def test_depth_that_is_late_tells_no_velocity_but_the_motion_of_the_colour() -> None:
    late = seen(BRISK, 0.1, skew_s=0.012)
    told, untold = laid(late, moving()), laid(replace(late, skew_s=0.0), moving())
    error_m, untold_m = (
        np.linalg.norm((inverse(each.T_camera_keyframe) - BRISK.at(0.1))[:3, 3])
        for each in (told, untold)
    )
    assert error_m < 0.0005
    assert untold_m > 3 * error_m


def moving() -> Tie:
    """The velocity is known as well as from frame to frame."""
    last = BRISK.at(0.1 - 1 / 30)
    return Tie(last, 30.0, -in_axes(BRISK.movement, last), known_within(np.array([0.03, 0.1])))


def test_an_instant_shutter_is_a_shutter_of_no_time() -> None:
    """With times that are nearly nothing all is nearly as with none."""
    frame = noisy(seen(BRISK, 0.1), 1)
    instant = laid(frame, moving())
    nearly = laid(replace(frame, readout_s=1e-9, skew_s=1e-9), moving())
    np.testing.assert_allclose(nearly.T_camera_keyframe, instant.T_camera_keyframe, atol=1e-6)
    np.testing.assert_allclose(nearly.movement, instant.movement, atol=1e-4)


def test_depth_alone_is_enough_in_a_corner() -> None:
    for frame, weights in (
        (dark(seen(BRISK, 0.1)), depth_alone()),
        (seen(BRISK, 0.1), depth_alone()),
    ):
        found = laid(frame, weights=weights)
        assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.1), 0.001, 0.03)
        assert not found.by_brightness
        assert lack(found).startswith("by depth alone")


def test_brightness_alone_is_enough_where_there_is_paint() -> None:
    found = laid(without_depth(seen(BRISK, 0.1)))
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.1), 0.004, 0.1)
    assert lack(found).startswith("by brightness alone")


def test_a_frame_of_another_place_is_doubted() -> None:
    away = Hand(np.array([0.0, 0.0, 0.0, 0.3, 1.5, 0.0]))
    assert doubt(laid(seen(away, 0.6))) != ""


def test_a_frame_that_tells_nothing_is_doubted() -> None:
    nothing = laid(without_depth(dark(seen(STILL))), weights=depth_alone())
    assert doubt(nothing) == "only 0 readings of what is in view"


def test_a_keyframe_of_fewer_sizes_is_laid_on_a_larger_image() -> None:
    images = make_images(seen(BRISK, 0.02))
    found = align(POINTS[:2], images, [np.eye(4)], LOOSE, (1.0, 0.0), all_alike())
    assert_close(inverse(found.T_camera_keyframe), BRISK.at(0.02), 0.001, 0.03)
