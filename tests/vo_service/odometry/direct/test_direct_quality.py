"""Validity of an alignment by its counts and residuals."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array
from tests.vo_service.odometry.direct.rolling_shutter_views import add_noise, render_view
from vo_service.odometry.direct import points as sampled
from vo_service.odometry.direct import residuals as columns
from vo_service.odometry.direct.alignment import (
    STATIC_PRIOR,
    DirectAlignment,
    align,
    depth_only_weights,
    uniform_weights,
)
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.motion import zero_motion
from vo_service.odometry.direct.points import select_points
from vo_service.odometry.direct.quality import (
    SUSPECT_SIGMAS,
    UsualSigmas,
    degradation_reason,
    is_consistent,
    occlusion_reason,
    outlier_score,
    rejection_reason,
    residual_score,
)

POINTS = select_points(build_image_pyramid(add_noise(render_view(), 0)), zero_motion(), ALL_STATIC)
GOOD = align(
    POINTS,
    build_image_pyramid(add_noise(render_view(), 1)),
    [np.eye(4)],
    STATIC_PRIOR,
    (1.0, 0.0),
    uniform_weights(),
)


def counted(**counts: float) -> DirectAlignment:
    changed = GOOD.counts.copy()
    for name, value in counts.items():
        changed[getattr(columns, name)] = value
    return replace(GOOD, counts=changed)


def fitted(**fit: float) -> DirectAlignment:
    changed = GOOD.residual_model.copy()
    for name, value in fit.items():
        changed[getattr(columns, name)] = value
    return replace(GOOD, residual_model=changed)


def test_a_good_alignment_is_accepted_without_a_reason() -> None:
    assert rejection_reason(GOOD) == degradation_reason(GOOD) == ""
    assert is_consistent(GOOD.counts)
    assert outlier_score(GOOD) < 1.0


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (counted(IN_IMAGE=40), "only 40 of "),
        (
            counted(DISREGARDED=0.9 * GOOD.counts[columns.IN_IMAGE]),
            "90 % of the view does not fit",
        ),
        (counted(DEPTH_AGREES=0), "depth samples agree with the keyframe"),
        (counted(BRIGHTNESS_AGREES=0), "brightness samples agree with the keyframe"),
        (counted(WITH_DEPTH=0, WITH_BRIGHTNESS=9), "only 9 samples in view"),
        (fitted(SIGMA_DEPTH=1.0), "the depth does not fit"),
        (fitted(SIGMA_BRIGHTNESS=100.0), "the brightness does not fit"),
        (fitted(GAIN=9.0), "the brightness changed too much against the keyframe"),
    ],
)
def test_a_bad_fit_is_rejected_and_reported(found: DirectAlignment, reason: str) -> None:
    assert reason in rejection_reason(found)


def test_brightness_without_weight_does_not_reject() -> None:
    dark = replace(fitted(SIGMA_BRIGHTNESS=100.0, GAIN=9.0), cell_weights=depth_only_weights())
    assert rejection_reason(dark) == ""
    assert outlier_score(dark) < 1.0 < outlier_score(fitted(SIGMA_BRIGHTNESS=100.0))


def usual_after(views: int, sigma_depth: float) -> UsualSigmas:
    usual, found = UsualSigmas(), fitted(SIGMA_DEPTH=sigma_depth)
    for _ in range(views):
        usual = usual.update(found)
    return usual


def test_residuals_that_are_usual_for_a_noisy_sensor_are_not_suspect() -> None:
    noisy, twice = fitted(SIGMA_DEPTH=2.6e-3), fitted(SIGMA_DEPTH=3.7e-3)
    assert outlier_score(noisy, UsualSigmas().suspect) > 1.0
    usual = usual_after(100, 1.8e-3)
    assert outlier_score(noisy, usual.suspect) < 1.0 < outlier_score(twice, usual.suspect)


def test_a_few_bad_views_hardly_change_what_is_usual() -> None:
    before = usual_after(100, 1.8e-3)
    after = before
    for _ in range(3):
        after = after.update(fitted(SIGMA_DEPTH=5e-3))
    assert after.suspect[1] < 1.1 * before.suspect[1]


def test_a_sensor_of_little_noise_is_judged_by_the_absolute_bound() -> None:
    assert usual_after(500, 0.8e-3).suspect == UsualSigmas().suspect == SUSPECT_SIGMAS


def test_missing_information_is_reported() -> None:
    assert "depth only" in degradation_reason(counted(WITH_BRIGHTNESS=0))
    assert "brightness only" in degradation_reason(counted(WITH_DEPTH=0))


def count_of(readings: Array) -> Array:
    return columns.count_residuals(POINTS[0], readings, GOOD.residual_model, uniform_weights())


def cost_of(readings: Array) -> float:
    return columns.robust_cost(POINTS[0], readings, GOOD.residual_model, uniform_weights())


def test_samples_are_counted_by_their_state() -> None:
    counts = count_of(GOOD.samples)
    assert counts[columns.IN_IMAGE] == np.count_nonzero(GOOD.samples[:, sampled.SAMPLE_CELL] >= 0)
    assert 0.9 * counts[columns.WITH_DEPTH] < counts[columns.DEPTH_AGREES]
    assert 0.9 * counts[columns.WITH_BRIGHTNESS] < counts[columns.BRIGHTNESS_AGREES]
    assert counts[columns.DISREGARDED] == 0


def test_an_occluded_point_is_not_counted_and_one_seen_through_disagrees() -> None:
    before, within = count_of(GOOD.samples), GOOD.samples[:, sampled.SAMPLE_CELL] < 16
    hidden, through = GOOD.samples.copy(), GOOD.samples.copy()
    for readings, sign in ((hidden, sampled.OCCLUDED), (through, -sampled.OCCLUDED)):
        readings[within, sampled.SAMPLE_OCCLUSION] = sign
        readings[within, sampled.SAMPLE_BRIGHTNESS] = readings[
            within, sampled.SAMPLE_DEPTH_RESIDUAL
        ] = np.nan
    assert count_of(hidden)[columns.NUM_OCCLUDED] == np.count_nonzero(within)
    assert count_of(hidden)[columns.IN_IMAGE] < before[columns.IN_IMAGE]
    assert is_consistent(count_of(hidden))
    assert cost_of(hidden) < cost_of(GOOD.samples)
    assert count_of(through)[columns.IN_IMAGE] == before[columns.IN_IMAGE]
    assert count_of(through)[columns.DEPTH_AGREES] < 0.8 * before[columns.DEPTH_AGREES]
    assert cost_of(through) > cost_of(GOOD.samples)


def test_points_agree_if_both_brightness_and_depth_do() -> None:
    agreeing = columns.find_inliers(POINTS[0], GOOD.samples, GOOD.residual_model)
    assert agreeing.mean() > 0.85
    for column, by in ((sampled.SAMPLE_BRIGHTNESS, 200.0), (sampled.SAMPLE_DEPTH_RESIDUAL, 0.05)):
        wrong = GOOD.samples.copy()
        wrong[::2, column] += by
        now = columns.find_inliers(POINTS[0], wrong, GOOD.residual_model)
        assert now[::2].mean() < 0.3
        np.testing.assert_array_equal(now[1::2], agreeing[1::2])


def occluded(share: float) -> DirectAlignment:
    readings = GOOD.samples.copy()
    readings[: int(share * len(readings)), sampled.SAMPLE_OCCLUSION] = sampled.OCCLUDED
    return replace(GOOD, samples=readings, counts=count_of(readings))


def test_a_mostly_occluded_view_is_rejected_however_well_the_rest_fits() -> None:
    assert occlusion_reason(GOOD) == occlusion_reason(occluded(0.4)) == ""
    assert "of the view is occluded" in occlusion_reason(occluded(0.7))
    assert rejection_reason(occluded(0.7)) == ""
    unfit = counted(DISREGARDED=0.7 * GOOD.counts[columns.IN_IMAGE])
    assert occlusion_reason(unfit) == "70 % of the view is occluded"


def test_a_partly_occluded_view_is_reported() -> None:
    assert degradation_reason(occluded(0.1)) == ""
    assert "of the view is occluded" in degradation_reason(occluded(0.4))


def test_a_bad_fit_everywhere_scores_worse_than_a_good_fit_except_for_a_corner() -> None:
    in_image = GOOD.counts[columns.IN_IMAGE]
    all_over = fitted(SIGMA_BRIGHTNESS=5.0 * GOOD.residual_model[columns.SIGMA_BRIGHTNESS])
    but_for_a_corner = counted(DISREGARDED=0.15 * in_image)
    assert outlier_score(but_for_a_corner) > outlier_score(all_over)
    assert residual_score(GOOD) < residual_score(but_for_a_corner) < residual_score(all_over)


def test_ignoring_half_of_the_view_does_not_improve_the_score() -> None:
    half = counted(DISREGARDED=0.5 * GOOD.counts[columns.IN_IMAGE])
    better = 0.6 * GOOD.residual_model[[columns.SIGMA_BRIGHTNESS, columns.SIGMA_DEPTH]]
    assert residual_score(
        replace(half, residual_model=np.array([1.0, 0.0, *better]))
    ) > residual_score(GOOD)
