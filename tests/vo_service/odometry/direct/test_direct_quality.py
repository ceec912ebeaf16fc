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
    degradation_reason,
    is_consistent,
    occlusion_reason,
    rejection_reason,
)

POINTS = select_points(build_image_pyramid(add_noise(render_view(), 0)), zero_motion(), ALL_STATIC)
GOOD = align(
    POINTS,
    build_image_pyramid(add_noise(render_view(), 1)),
    np.eye(4),
    STATIC_PRIOR,
    1.0,
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


def test_missing_information_is_reported() -> None:
    assert "depth only" in degradation_reason(counted(WITH_BRIGHTNESS=0))
    assert "brightness only" in degradation_reason(counted(WITH_DEPTH=0))


def count_of(readings: Array) -> Array:
    return columns.count_residuals(POINTS[0], readings, GOOD.residual_model, uniform_weights())


def cost_of(readings: Array) -> float:
    return float(columns.negative_log_likelihood(POINTS[0], readings, GOOD.residual_model))


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
    assert count_of(through)[columns.IN_IMAGE] == before[columns.IN_IMAGE]
    assert count_of(through)[columns.DEPTH_AGREES] < 0.8 * before[columns.DEPTH_AGREES]
    assert cost_of(through) > cost_of(GOOD.samples)
    others = POINTS[0][~within], hidden[~within]
    of_others = columns.negative_log_likelihood(*others, GOOD.residual_model)
    assert cost_of(hidden) == pytest.approx(of_others)


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


def test_of_two_motions_the_one_with_larger_residuals_is_less_likely() -> None:
    wrong = GOOD.samples.copy()
    wrong[:, sampled.SAMPLE_BRIGHTNESS] += 5.0
    assert cost_of(wrong) > cost_of(GOOD.samples)
    large = fitted(SIGMA_DEPTH=5.0 * GOOD.residual_model[columns.SIGMA_DEPTH])
    worse = columns.negative_log_likelihood(POINTS[0], GOOD.samples, large.residual_model)
    assert worse > cost_of(GOOD.samples)
