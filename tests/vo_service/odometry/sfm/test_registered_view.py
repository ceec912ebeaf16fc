"""Covariance of a registered view."""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import inverse
from tests.vo_service.odometry.sfm.ray_pairs import MOTION, make_pairs
from tests.vo_service.odometry.sfm.sideways_sequence import render_view
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.sfm.keyframe import (
    COVARIANCE_INFLATION,
    MIN_SIGMA_PX,
    MatchedView,
    RegisteredView,
    SfmKeyframe,
)
from vo_service.odometry.sfm.mono_frame import MonoFrame
from vo_service.odometry.sfm.two_view_refinement import refine_two_view


def placed(count: int = 150) -> RegisteredView:
    """A view registered by this number of known points."""
    camera = MonoFrame.from_features(SurfExtractor(20).extract(render_view(0).gray), render_view(0))
    pairs = make_pairs(MOTION, known_to=0.02, count=count)
    matched = MatchedView(
        camera, SfmKeyframe.from_view(camera, np.eye(4)), np.zeros((count, 2), int), pairs, None
    )
    return RegisteredView(matched, refine_two_view(inverse(MOTION), pairs))


def test_fewer_inliers_increase_the_covariance_of_the_motion() -> None:
    good = placed()
    inlier = good.two_view.inlier.copy()
    inlier[75:] = False
    doubtful = replace(good, two_view=replace(good.two_view, inlier=inlier))
    more = (doubtful.covariance - good.covariance)[3:, 3:]
    np.testing.assert_allclose(
        more, 3.0 * COVARIANCE_INFLATION**2 * good.two_view.covariance[3:, 3:]
    )


def test_no_number_of_points_makes_a_motion_exact() -> None:
    good = placed()
    exact = replace(good, two_view=replace(good.two_view, covariance=np.zeros((6, 6))))
    shift_rad = MIN_SIGMA_PX / good.matched_view.view.focal_px
    np.testing.assert_allclose(np.sqrt(np.diag(exact.covariance))[3:], shift_rad)
    assert exact.max_sigma_rad > 0.99 * shift_rad


def test_fewer_points_increase_the_uncertainty() -> None:
    assert placed(10).max_sigma_rad > 2.0 * placed(150).max_sigma_rad
