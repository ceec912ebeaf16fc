"""How sure a placed view is."""

from dataclasses import replace

import numpy as np

from drivers.geometry import inverse
from tests.vo_service.odometry.sfm.ray_views import MOTION, pairs_of
from tests.vo_service.odometry.sfm.sideways import view
from vo_service.odometry.sfm.colour_view import ColourView
from vo_service.odometry.sfm.keyframe import Keyframe
from vo_service.odometry.sfm.placed import SHARED, SHIFT_PX, Placed, Sight
from vo_service.odometry.sfm.refinement import refine_motion
from vo_service.odometry.surf import SurfExtractor


def placed(count: int = 150) -> Placed:
    """By so many known points."""
    camera = ColourView.of(SurfExtractor(20).extract(view(0).grey), view(0))
    pairs = pairs_of(MOTION, known_to=0.02, count=count)
    sight = Sight(camera, Keyframe.of(camera, np.eye(4)), np.zeros((count, 2), int), pairs, None)
    return Placed(sight, refine_motion(inverse(MOTION), pairs))


def test_where_fewer_of_the_matches_agree_those_that_do_are_believed_less() -> None:
    good = placed()
    inlier = good.refined.inlier.copy()
    inlier[75:] = False
    doubtful = replace(good, refined=replace(good.refined, inlier=inlier))
    more = (doubtful.covariance - good.covariance)[3:, 3:]
    np.testing.assert_allclose(more, 3.0 * SHARED**2 * good.refined.covariance[3:, 3:])


def test_no_number_of_points_makes_a_motion_exact() -> None:
    good = placed()
    exact = replace(good, refined=replace(good.refined, covariance=np.zeros((6, 6))))
    shift_rad = SHIFT_PX / good.sight.view.focal_px
    np.testing.assert_allclose(np.sqrt(np.diag(exact.covariance))[3:], shift_rad)
    assert exact.doubt_rad > 0.99 * shift_rad


def test_fewer_points_leave_more_doubt() -> None:
    assert placed(10).doubt_rad > 2.0 * placed(150).doubt_rad
