"""What else is tried with a frame that does not fit the last good one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array, carried, inverse
from vo_service.odometry.chance import ChanceTest
from vo_service.odometry.good_views import GoodViews
from vo_service.odometry.guided_matching import match_near
from vo_service.odometry.matching import match_features
from vo_service.odometry.motion_model import MotionModel
from vo_service.odometry.parameters import SurfParameters
from vo_service.odometry.points import pair_points
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.refinement import Motion, refine_motion
from vo_service.odometry.view import View, draw, with_depth
from vo_service.types import Evidence

# Features of an older view are sought in the whole image: the values of Brown and Lowe.
BY_OLDER_VIEW = ChanceTest(if_right=0.6, by_chance=0.1)
# Near the place where a feature is expected there are more wrong ones that look alike; but in a
# circle of 24 pixels or more, few of these are within the 2 pixels of an inlier.
BY_PREDICTION = ChanceTest(if_right=0.15, by_chance=0.01)


@dataclass(frozen=True)
class Found:
    """Where a lost camera is.

    T_world_camera  4x4
    T_last_camera   4x4 motion since the last good frame
    covariance      6x6 of T_last_camera, as that of an `Estimate`
    evidence        the view that it was found by is the reference
    """

    T_world_camera: Array
    T_last_camera: Array
    covariance: Array
    evidence: Evidence


class Recovery:
    """Follows a chain of good frames, so as to find the camera when the chain breaks."""

    def __init__(self, parameters: SurfParameters) -> None:
        self._parameters = parameters
        self._model = MotionModel()
        self._places = GoodViews()
        self._T_world_last = np.eye(4)

    def begin(self, view: View, T_world_camera: Array) -> None:
        """The first view of a chain, which goes on from no other."""
        self._model.begin(view.stamp_s)
        self._places.begin(view, T_world_camera)
        self._T_world_last = T_world_camera

    def add(
        self, view: View, T_world_camera: Array, T_last_camera: Array, covariance: Array
    ) -> None:
        """The next good view of the chain, and the motion to it from the one before."""
        self._model.add(T_last_camera, view.stamp_s)
        self._places.add(view, T_world_camera, T_last_camera, covariance)
        self._T_world_last = T_world_camera

    def find(self, view: View, last: View, turn: int) -> Found | None:
        """Two tries at most: by the last view, then by the older one whose turn it is."""
        return self._by_prediction(view, last) or self._by_older_view(view, last, turn)

    def _by_prediction(self, view: View, last: View) -> Found | None:
        """The last view once more, searched only where the motion so far has the features."""
        prediction = self._model.predict(view.stamp_s)
        if prediction is None:
            return None
        matches = match_near(view, last, prediction)
        motion = self._motion(view, last, matches)
        if not self._is_right(motion, BY_PREDICTION):
            return None
        T_last_camera = motion.T_reference_camera
        return Found(
            T_world_camera=self._T_world_last @ T_last_camera,
            T_last_camera=T_last_camera,
            covariance=motion.covariance,
            evidence=draw(view, last, matches, motion),
        )

    def _by_older_view(self, view: View, last: View, turn: int) -> Found | None:
        """A view of another place, without any expectation: the camera may have turned back."""
        older = self._places.other_than(last)
        if not older:
            return None
        place = older[turn % len(older)]
        pairs = match_features(view.features, place.view.features, self._parameters.match_ratio)
        matches = with_depth(view, place.view, pairs)
        motion = self._motion(view, place.view, matches)
        if not self._is_right(motion, BY_OLDER_VIEW):
            return None
        T_world_camera = place.T_world_view @ motion.T_reference_camera
        T_last_camera = inverse(self._T_world_last) @ T_world_camera
        return Found(
            T_world_camera=T_world_camera,
            T_last_camera=T_last_camera,
            covariance=carried(place.covariance, T_last_camera) + motion.covariance,
            evidence=draw(view, place.view, matches, motion),
        )

    def _motion(self, view: View, reference: View, matches: NDArray[np.int64]) -> Motion:
        pairs = pair_points(view.points, reference.points, matches)
        consensus = find_consensus(pairs, self._parameters.max_hypotheses, self._parameters.seed)
        return refine_motion(consensus, pairs)

    def _is_right(self, motion: Motion, test: ChanceTest) -> bool:
        inliers = int(motion.inlier.sum())
        return inliers >= self._parameters.min_inliers and test.is_passed(
            inliers, matches=len(motion.inlier)
        )
