"""Finding the camera by features, where it is not where it was expected."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from vo_service.odometry.chance import ChanceTest
from vo_service.odometry.grey_frame import GreyFrame
from vo_service.odometry.keyframe.local_map import Keyframe
from vo_service.odometry.keyframe.parameters import SIGHTED
from vo_service.odometry.matching import match_features
from vo_service.odometry.parameters import SurfParameters
from vo_service.odometry.points import locate_features, pair_points
from vo_service.odometry.ransac import find_consensus
from vo_service.odometry.refinement import refine_motion
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.view import View, with_depth

# A sighting is only where an alignment begins, which then shows whether it is right. A shutter that
# rolls bends what is seen: few of the matches agree with any one motion.
IS_SIGHTED = ChanceTest(*SIGHTED)


@dataclass(frozen=True)
class Sighting:
    """A keyframe that is in view, and the motion T_camera_keyframe (4x4) that features give."""

    keyframe: Keyframe
    T_camera_keyframe: Array


class FeatureSearch:
    """SURF on a frame and on keyframes; a keyframe's are found once, when they are first needed."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.extractor = extractor
        self._parameters = SurfParameters()
        self._views: WeakKeyDictionary[Keyframe, View] = WeakKeyDictionary()

    def find(self, frame: RgbdFrame, keyframes: Sequence[Keyframe]) -> Iterator[Sighting]:
        """The keyframes that enough features of a frame agree with, in their order."""
        view = self._view(frame)
        for keyframe in keyframes:
            if keyframe not in self._views:
                self._views[keyframe] = self._view(keyframe.frame)
            T_keyframe_camera = self._motion(view, self._views[keyframe])
            if T_keyframe_camera is not None:
                yield Sighting(keyframe, inverse(T_keyframe_camera))

    def _view(self, frame: RgbdFrame | GreyFrame) -> View:
        features = self.extractor.extract(frame.grey)
        return View(features, locate_features(features, frame), frame.camera, frame.stamp_s)

    def _motion(self, view: View, reference: View) -> Array | None:
        """4x4 T_reference_camera; None if features that agree may do so by chance."""
        parameters = self._parameters
        pairs = match_features(view.features, reference.features, parameters.match_ratio)
        matches = pair_points(view.points, reference.points, with_depth(view, reference, pairs))
        consensus = find_consensus(matches, parameters.max_hypotheses, parameters.seed)
        motion = refine_motion(consensus, matches)
        inliers = int(motion.inlier.sum())
        if inliers < parameters.min_inliers or not IS_SIGHTED.is_passed(inliers, len(matches)):
            return None
        return motion.T_reference_camera
