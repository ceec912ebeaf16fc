"""How sure an alignment is, and of what."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.geometry import (
    Array,
    inverse,
    rigid_transform,
    rotation_from_vector,
    rotation_vector,
)
from tests.vo_service.odometry.keyframe.rolling_views import (
    BRISK,
    CORNER,
    FLOOR,
    SIDE,
    WALL,
    Hand,
    Plane,
    noisy,
    seen,
    without_depth,
)
from vo_service.odometry.keyframe.alignment import STANDING, Tie, align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.certainty import Certainty, certainty
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.local_map import Keyframe, make_keyframe
from vo_service.odometry.keyframe.movement import at_rest
from vo_service.odometry.keyframe.readings import BANDS

# 95 % of what is normally distributed in six directions is nearer.
CHI_SQUARED_95 = 12.59
CALM = np.zeros(2)
VAGUE = replace(STANDING, information=np.ones(9))


def keyframe_of(frame: RgbdFrame) -> Keyframe:
    return make_keyframe(frame, make_images(frame), np.eye(4), at_rest(), ALL_STILL)


def laid(
    keyframe: Keyframe, frame: RgbdFrame, tie: Tie = STANDING, agitation: Array = CALM
) -> tuple[Certainty, Array]:
    """How sure, and T_keyframe_camera."""
    images = make_images(frame)
    found = align(keyframe.points, images, [np.eye(4)], tie, (1.0, 0.0), all_alike())
    return certainty(keyframe.points, images, found, tie, agitation), inverse(
        found.T_camera_keyframe
    )


def itself(frame: RgbdFrame) -> Certainty:
    return laid(keyframe_of(frame), frame)[0]


@pytest.mark.parametrize(
    ("planes", "open_directions"), [((WALL,), 3), ((WALL, FLOOR), 1), ((WALL, SIDE), 1)]
)
def test_bare_planes_leave_directions_open(planes: Sequence[Plane], open_directions: int) -> None:
    for seed in (1, 2):
        doubt = itself(noisy(seen(planes=planes, paint=0.0), seed)).doubt
        assert doubt == f"too plain a view: {open_directions} of 6 directions of motion are open"


@pytest.mark.parametrize("planes", [(WALL,), (WALL, FLOOR), (WALL, SIDE)])
def test_bare_planes_without_noise_leave_directions_open_too(planes: Sequence[Plane]) -> None:
    assert itself(seen(planes=planes, paint=0.0)).doubt.startswith("too plain a view: ")


@pytest.mark.parametrize("planes", [(WALL,), (WALL, FLOOR), CORNER])
def test_paint_or_a_corner_settle_all_directions(planes: Sequence[Plane]) -> None:
    assert itself(noisy(seen(planes=planes), 1)).doubt == ""
    assert itself(noisy(seen(paint=0.0), 1)).doubt == ""


def test_paint_settles_all_directions_without_depth_in_the_frame() -> None:
    keyframe = keyframe_of(noisy(seen(planes=(WALL,)), 1))
    assert laid(keyframe, without_depth(noisy(seen(planes=(WALL,)), 2)))[0].doubt == ""


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_the_covariance_is_symmetric_and_positive(readout_s: float) -> None:
    frame = noisy(seen(BRISK, 0.03, readout_s=readout_s), 1)
    covariance = laid(keyframe_of(noisy(seen(), 0)), frame)[0].covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0


def sigma_m(frame: RgbdFrame, keyframe: Keyframe) -> float:
    return float(np.sqrt(np.trace(laid(keyframe, frame)[0].covariance[:3, :3])))


def test_more_noise_makes_it_less_sure() -> None:
    keyframe, frame = keyframe_of(noisy(seen(), 0)), seen(BRISK, 0.03)
    sigmas = [sigma_m(noisy(frame, 1, times), keyframe) for times in (1.0, 3.0, 9.0)]
    assert sigmas[0] < sigmas[1] < sigmas[2]


def test_less_to_see_makes_it_less_sure() -> None:
    keyframe, frame = keyframe_of(noisy(seen(), 0)), noisy(seen(BRISK, 0.03), 1)
    assert sigma_m(frame, keyframe) < sigma_m(without_depth(frame), keyframe)


def test_a_wall_of_weak_paint_holds_the_camera_worst_along_itself() -> None:
    keyframe = keyframe_of(noisy(seen(planes=(WALL,), paint=0.25), 0))
    sure, _ = laid(keyframe, noisy(seen(planes=(WALL,), paint=0.25), 1))
    across = np.array(WALL[0]) / np.linalg.norm(WALL[0])
    along = np.cross(across, [0.0, 1.0, 0.0])
    in_metres = sure.covariance[:3, :3]
    assert along @ in_metres @ along > 2 * across @ in_metres @ across


def test_it_is_told_in_the_axes_of_the_camera() -> None:
    """Where two bare planes meet nothing holds a camera along their edge, however it is turned."""
    planes, turned = (
        (WALL, FLOOR),
        rigid_transform(rotation_from_vector([0.0, 0.0, 0.5]), np.zeros(3)),
    )
    keyframe = keyframe_of(noisy(seen(planes=planes, paint=0.0), 0))
    images = make_images(noisy(seen(Hand(T_world_start=turned), planes=planes, paint=0.0), 1))
    start = inverse(turned)
    found = align(keyframe.points, images, [start], STANDING, (1.0, 0.0), all_alike())
    covariance = certainty(keyframe.points, images, found, STANDING, CALM).covariance[:3, :3]
    edge = np.cross(WALL[0], FLOOR[0])
    along, elsewhere = turned[:3, :3].T @ edge, turned[:3, :3] @ edge
    assert along @ covariance @ along > 1.5 * elsewhere @ covariance @ elsewhere
    most = np.linalg.eigh(covariance)[1][:, 2]
    assert abs(most @ along) > 0.95 * np.linalg.norm(edge)


@pytest.mark.parametrize("how", ["velocity not known", "agitated"])
def test_with_a_rolling_shutter_it_is_less_sure_of_what_it_did_meanwhile(how: str) -> None:
    keyframe = keyframe_of(noisy(seen(), 0))
    for readout_s in (0.0, 0.02):
        frame = noisy(seen(readout_s=readout_s), 1)
        calm = np.trace(laid(keyframe, frame)[0].covariance)
        if how == "agitated":
            other = np.trace(laid(keyframe, frame, STANDING, np.array([0.5, 1.0]))[0].covariance)
        else:
            other = np.trace(laid(keyframe, frame, VAGUE)[0].covariance)
        assert (other > 1.1 * calm) == (readout_s > 0)


def test_an_agitated_camera_strays_about_as_far_as_in_one_row() -> None:
    keyframe, frame = keyframe_of(noisy(seen(), 0)), noisy(seen(readout_s=0.02), 1)
    calm, agitated = (
        np.trace(laid(keyframe, frame, STANDING, np.array([mps, 0.0]))[0].covariance[:3, :3])
        for mps in (0.0, 0.5)
    )
    in_a_row = 3 * (0.02 * 0.5) ** 2 / 12.0
    # Bands of rows even it out where all hold the camera; where few do, they pull against others.
    assert in_a_row / (2 * BANDS) < agitated - calm < 4.0 * in_a_row


def test_over_many_noises_the_error_is_of_the_size_that_it_says() -> None:
    """Not 95 times in a hundred to the letter, but neither half of the time nor ten times off."""
    frame, truth, distances = seen(BRISK, 0.03), BRISK.at(0.03), []
    blank = seen()
    for seed in range(25):
        sure, T = laid(keyframe_of(noisy(blank, 2 * seed)), noisy(frame, 2 * seed + 1))
        off = inverse(T) @ truth
        error = np.concatenate([off[:3, 3], rotation_vector(off[:3, :3])])
        distances.append(float(error @ np.linalg.solve(sure.covariance, error)))
    assert np.mean(np.array(distances) < CHI_SQUARED_95) > 0.8
    # Six on average, if all of it were true.
    assert np.mean(distances) > 0.3
