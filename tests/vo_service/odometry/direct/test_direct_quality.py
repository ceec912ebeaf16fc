"""Validity of an alignment by its counts and residuals."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.odometry.direct.rolling_shutter_views import add_noise, render_view
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
from vo_service.odometry.direct.residuals import (
    ResidualCounts,
    count_residuals,
    find_inliers,
    negative_log_likelihood,
)
from vo_service.odometry.direct.samples import Samples

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
    return replace(GOOD, counts=GOOD.counts._replace(**counts))


def fitted(**fit: float) -> DirectAlignment:
    return replace(GOOD, residual_model=GOOD.residual_model._replace(**fit))


def test_a_good_alignment_is_accepted_without_a_reason() -> None:
    assert rejection_reason(GOOD) == degradation_reason(GOOD) == ""
    assert is_consistent(GOOD.counts)


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (counted(in_image=40), "only 40 of "),
        (
            counted(disregarded=0.9 * GOOD.counts.in_image),
            "90 % of the view does not fit",
        ),
        (counted(depth_agrees=0), "depth samples agree with the keyframe"),
        (counted(brightness_agrees=0), "brightness samples agree with the keyframe"),
        (counted(with_depth=0, with_brightness=9), "only 9 samples in view"),
        (fitted(sigma_depth=1.0), "the depth does not fit"),
        (fitted(sigma_brightness=100.0), "the brightness does not fit"),
        (fitted(gain=9.0), "the brightness changed too much against the keyframe"),
    ],
)
def test_a_bad_fit_is_rejected_and_reported(found: DirectAlignment, reason: str) -> None:
    assert reason in rejection_reason(found)


def test_brightness_without_weight_does_not_reject() -> None:
    dark = replace(fitted(sigma_brightness=100.0, gain=9.0), cell_weights=depth_only_weights())
    assert rejection_reason(dark) == ""


def test_missing_information_is_reported() -> None:
    assert "depth only" in degradation_reason(counted(with_brightness=0))
    assert "brightness only" in degradation_reason(counted(with_depth=0))


def count_of(samples: Samples) -> ResidualCounts:
    return count_residuals(POINTS[0], samples, GOOD.residual_model, uniform_weights())


def cost_of(samples: Samples) -> float:
    return negative_log_likelihood(POINTS[0], samples, GOOD.residual_model)


def test_samples_are_counted_by_their_state() -> None:
    counts = count_of(GOOD.samples)
    assert counts.in_image == np.count_nonzero(GOOD.samples.cell >= 0)
    assert 0.9 * counts.with_depth < counts.depth_agrees
    assert 0.9 * counts.with_brightness < counts.brightness_agrees
    assert counts.disregarded == 0


def test_an_occluded_point_is_not_counted_and_one_seen_through_disagrees() -> None:
    before, within = count_of(GOOD.samples), GOOD.samples.cell < 16
    hidden, through = deepcopy(GOOD.samples), deepcopy(GOOD.samples)
    for samples, occlusion in ((hidden, 1), (through, -1)):
        samples.occlusion[within] = occlusion
        samples.brightness[within] = samples.depth_residual[within] = np.nan
    assert count_of(hidden).occluded == np.count_nonzero(within)
    assert count_of(hidden).in_image < before.in_image
    assert is_consistent(count_of(hidden))
    assert count_of(through).in_image == before.in_image
    assert count_of(through).depth_agrees < 0.8 * before.depth_agrees
    assert cost_of(through) > cost_of(GOOD.samples)
    others = Samples._make(each[~within] for each in hidden)
    of_others = negative_log_likelihood(POINTS[0].select(~within), others, GOOD.residual_model)
    assert cost_of(hidden) == pytest.approx(of_others)


def test_points_agree_if_both_brightness_and_depth_do() -> None:
    agreeing = find_inliers(POINTS[0], GOOD.samples, GOOD.residual_model)
    assert agreeing.mean() > 0.85
    for column, by in (("brightness", 200.0), ("depth_residual", 0.05)):
        wrong = deepcopy(GOOD.samples)
        getattr(wrong, column)[::2] += by
        now = find_inliers(POINTS[0], wrong, GOOD.residual_model)
        assert now[::2].mean() < 0.3
        np.testing.assert_array_equal(now[1::2], agreeing[1::2])


def occluded(share: float) -> DirectAlignment:
    samples = deepcopy(GOOD.samples)
    samples.occlusion[: int(share * len(samples.occlusion))] = 1
    return replace(GOOD, samples=samples, counts=count_of(samples))


def test_a_mostly_occluded_view_is_rejected_however_well_the_rest_fits() -> None:
    assert occlusion_reason(GOOD) == occlusion_reason(occluded(0.4)) == ""
    assert "of the view is occluded" in occlusion_reason(occluded(0.7))
    assert rejection_reason(occluded(0.7)) == ""
    unfit = counted(disregarded=0.7 * GOOD.counts.in_image)
    assert occlusion_reason(unfit) == "70 % of the view is occluded"


def test_a_partly_occluded_view_is_reported() -> None:
    assert degradation_reason(occluded(0.1)) == ""
    assert "of the view is occluded" in degradation_reason(occluded(0.4))


def test_of_two_motions_the_one_with_larger_residuals_is_less_likely() -> None:
    wrong = deepcopy(GOOD.samples)
    wrong.brightness[:] += 5.0
    assert cost_of(wrong) > cost_of(GOOD.samples)
    large = fitted(sigma_depth=5.0 * GOOD.residual_model.sigma_depth)
    worse = negative_log_likelihood(POINTS[0], GOOD.samples, large.residual_model)
    assert worse > cost_of(GOOD.samples)
