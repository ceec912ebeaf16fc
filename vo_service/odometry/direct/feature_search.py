"""Search for the keyframes in view by features, where the prediction fails."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.local_map import DirectKeyframe
from vo_service.odometry.direct.parameters import FEATURE_INLIER_SHARES
from vo_service.odometry.feature_points import backproject_features, pair_points
from vo_service.odometry.feature_view import FeatureView, select_pairs_with_depth
from vo_service.odometry.gray_frame import GrayFrame
from vo_service.odometry.match_verification import MatchVerifier
from vo_service.odometry.matching import match_features
from vo_service.odometry.motion_refinement import refine_rigid_motion
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.surf.parameters import SurfParameters

# A match is only the initial guess of an alignment, which verifies it. A rolling shutter distorts
# the view, so that few of the feature matches agree with any one motion.
FEATURE_MATCH_VERIFIER = MatchVerifier(*FEATURE_INLIER_SHARES)


@dataclass(frozen=True)
class KeyframeMatch:
    """A keyframe in view, and the motion T_camera_keyframe (4x4) by features."""

    keyframe: DirectKeyframe
    T_camera_keyframe: Array


class FeatureSearch:
    """SURF features of a frame and of keyframes; those of a keyframe are cached."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.extractor = extractor
        self._parameters = SurfParameters()
        self._views: WeakKeyDictionary[DirectKeyframe, FeatureView] = WeakKeyDictionary()

    def find_matches(
        self, frame: RgbdFrame, keyframes: Sequence[DirectKeyframe]
    ) -> Iterator[KeyframeMatch]:
        """Yield the keyframes that enough features of a frame agree with, in their order."""
        view = self._make_view(frame)
        for keyframe in keyframes:
            if keyframe not in self._views:
                self._views[keyframe] = self._make_view(keyframe.frame)
            T_keyframe_camera = self._estimate_motion(view, self._views[keyframe])
            if T_keyframe_camera is not None:
                yield KeyframeMatch(keyframe, inverse(T_keyframe_camera))

    def _make_view(self, frame: RgbdFrame | GrayFrame) -> FeatureView:
        features = self.extractor.extract(frame.gray)
        return FeatureView(
            features, backproject_features(features, frame), frame.camera, frame.stamp_s
        )

    def _estimate_motion(self, view: FeatureView, reference: FeatureView) -> Array | None:
        """4x4 T_reference_camera; None if the features may agree by chance."""
        parameters = self._parameters
        pairs = match_features(view.features, reference.features, parameters.match_ratio)
        matches = pair_points(
            view.points, reference.points, select_pairs_with_depth(view, reference, pairs)
        )
        consensus = find_consensus(matches, parameters.max_hypotheses, parameters.seed)
        motion = refine_rigid_motion(consensus, matches)
        inliers = int(motion.inlier.sum())
        if inliers < parameters.min_inliers or not FEATURE_MATCH_VERIFIER.accepts(
            inliers, len(matches)
        ):
            return None
        return motion.T_reference_camera
