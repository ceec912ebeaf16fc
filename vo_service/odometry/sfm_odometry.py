"""Structure from motion: how the camera moves by colour alone, but for a first scale.

Nistér, Naroditsky and Bergen, "Visual odometry", CVPR 2004; Scaramuzza and Fraundorfer, "Visual
odometry, part I", IEEE Robotics and Automation Magazine 18 (2011), whose steps these are.
"""

from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.odometry.chance import ChanceTest
from vo_service.odometry.matching import match_features
from vo_service.odometry.sfm.chain import Chain, Link
from vo_service.odometry.sfm.colour_view import ColourView
from vo_service.odometry.sfm.essential import find_direction
from vo_service.odometry.sfm.first_pair import FirstView
from vo_service.odometry.sfm.keyframe import Keyframe
from vo_service.odometry.sfm.parameters import SfmParameters
from vo_service.odometry.sfm.placed import NotPlaced, Placed, Sight
from vo_service.odometry.sfm.refinement import refine_best, refine_motion
from vo_service.odometry.sfm.scale import motions_to_scale
from vo_service.odometry.sfm.scale_source import FirstDepth, ScaleSource
from vo_service.odometry.stopwatch import NullStopwatch, Stopwatch
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.surf_odometry import FeatureExtractor
from vo_service.types import Estimate, Evidence

# Known points agree or not within a few pixels of where they ought to be: few do so by chance.
BY_KNOWN_POINTS = ChanceTest(if_right=0.5, by_chance=0.05)


class SfmOdometry:
    """Keyframe odometry by colour alone; a frame that fails is left out. World: the first camera.

    Until the camera has moved far enough from where it began there is no pose. `scale_source`
    then says how far that is; from there on the points in common carry the scale. Where tracking
    begins anew after a loss the old scale is lost, and the source is asked again.
    """

    def __init__(
        self,
        extractor: FeatureExtractor | None = None,
        parameters: SfmParameters | None = None,
        stopwatch: Stopwatch | None = None,
        scale_source: ScaleSource | None = None,
    ) -> None:
        self._extractor = extractor or SurfExtractor()
        self._parameters = parameters or SfmParameters()
        self._stopwatch = stopwatch or NullStopwatch()
        self._first = FirstView(self._parameters, scale_source or FirstDepth())
        self._chain = Chain(self._parameters)
        self._failures = 0

    @property
    def feature_count(self) -> int:
        """Features to find in a frame; may be set, and counts from the next frame on."""
        return self._extractor.count

    @feature_count.setter
    def feature_count(self, count: int) -> None:
        self._extractor.count = count

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is, from this frame and the keyframes."""
        # Features.
        with self._stopwatch.stage("surf"):
            view = ColourView.of(self._extractor.extract(frame.grey), frame)
            view = self._chain.expected(view)
        keyframes = self._chain.window.keyframes
        if not keyframes:
            return self._start(view, frame, restarted=False)
        sight = self._look(view, keyframes[0])
        if not self._chain.has_scale:
            return self._place_second(sight, frame)
        placed = self._place(sight)
        if isinstance(placed, NotPlaced):
            placed = self._recover(placed)
        if isinstance(placed, NotPlaced):
            return self._fail(placed, frame)
        # Once more with the velocity that is known now, if the shutter rolls.
        with self._stopwatch.stage("refine"):
            placed = self._steadied(placed)
        # Concatenation.
        with self._stopwatch.stage("points"):
            link = self._chain.add(placed)
        return self._succeed(placed, link)

    def _look(self, view: ColourView, keyframe: Keyframe) -> Sight:
        """What two views say of the motion between them, but for its length."""
        # Matching.
        with self._stopwatch.stage("match"):
            ratio = self._parameters.match_ratio
            matches = match_features(view.features, keyframe.view.features, ratio)
            pairs = self._chain.window.pairs(view, keyframe, matches)
        # Essential matrix by RANSAC, cheirality.
        with self._stopwatch.stage("ransac"):
            direction = find_direction(pairs, self._parameters.seed)
        return Sight(view, keyframe, matches, pairs, direction)

    def _place(self, sight: Sight) -> Placed | NotPlaced:
        """The motion in metres, by the points that are known already."""
        common = int(sight.pairs.known.sum())
        if common < self._parameters.min_inliers:
            return NotPlaced(sight, f"{common} of {len(sight.matches)} matches are known points")
        # Triangulation, and scale from the points in common.
        with self._stopwatch.stage("scale"):
            guesses = motions_to_scale(sight.direction, sight.pairs)
        # Refinement by reprojection error.
        with self._stopwatch.stage("refine"):
            guesses.append(self._chain.guess(sight.keyframe))
            placed = Placed(sight, refine_best(guesses, sight.pairs))
        agree = placed.known_inliers
        if agree < self._parameters.min_inliers or not BY_KNOWN_POINTS.is_passed(agree, common):
            return NotPlaced(sight, f"{agree} of {common} known points agree")
        if self._chain.is_too_far(placed):
            return NotPlaced(sight, f"{agree} points agree on a step too long for a camera")
        if placed.doubt_rad > self._parameters.max_doubt_rad:
            return NotPlaced(sight, f"the {agree} points that agree leave the motion open")
        return placed

    def _steadied(self, placed: Placed) -> Placed:
        """The view placed again, each row at its own instant."""
        sight = placed.sight
        if not sight.view.rolls:
            return placed
        view = sight.view.sweeping(self._chain.sweep_to(placed))
        pairs = self._chain.window.pairs(view, sight.keyframe, sight.matches)
        refined = refine_motion(placed.refined.T_camera_reference, pairs)
        again = Placed(replace(sight, view=view, pairs=pairs), refined)
        return min(placed, again, key=lambda each: each.refined.cost)

    def _place_second(self, sight: Sight, frame: RgbdFrame) -> Estimate:
        """The second view with parallax to the first: triangulation, and the first scale."""
        with self._stopwatch.stage("scale"):
            found = self._first.place(sight)
        if isinstance(found, NotPlaced):
            return self._fail(found, frame)
        with self._stopwatch.stage("points"):
            link = self._chain.set_scale(found.placed, found.sigma)
        return self._succeed(found.placed, link)

    def _recover(self, failed: NotPlaced) -> Placed | NotPlaced:
        """Try the last good frame, if it is no keyframe; and an older keyframe, each in turn."""
        view = failed.sight.view
        if self._chain.make_last_a_keyframe():
            placed = self._place(self._look(view, self._chain.window.keyframes[0]))
            if isinstance(placed, Placed):
                return placed
        older = self._chain.window.keyframes[1:]
        if not older:
            return failed
        placed = self._place(self._look(view, older[self._failures % len(older)]))
        return placed if isinstance(placed, Placed) else failed

    def _start(self, view: ColourView, frame: RgbdFrame, restarted: bool) -> Estimate:
        """Make this view the first of a chain, if it has enough features to be found again."""
        evidence = Evidence(keypoints_px=view.features.position_px)
        fewest = self._parameters.first_inliers
        if len(view.features) < fewest:
            return self._left_out(f"too few features to start: {len(view.features)}", evidence)
        self._chain.begin(view)
        self._first.begin(frame)
        self._failures = 0
        return self._estimate("", Link(np.eye(4), np.zeros((6, 6))), evidence, restarted)

    def _succeed(self, placed: Placed, link: Link) -> Estimate:
        self._failures = 0
        return self._estimate("", link, placed.sight.evidence(placed.refined.inlier))

    def _fail(self, failed: NotPlaced, frame: RgbdFrame) -> Estimate:
        """Hold the pose; after too many failures begin anew with this view."""
        self._failures = 0 if failed.waiting else self._failures + 1
        if self._failures > self._parameters.max_failures:
            return self._start(failed.sight.view, frame, restarted=True)
        nothing = np.zeros(len(failed.sight.matches), np.bool_)
        return self._left_out(failed.reason, failed.sight.evidence(nothing))

    def _left_out(self, reason: str, evidence: Evidence) -> Estimate:
        return self._estimate(reason, Link(np.eye(4), np.zeros((6, 6))), evidence)

    def _estimate(
        self, reason: str, link: Link, evidence: Evidence, restarted: bool = False
    ) -> Estimate:
        return Estimate(
            ok=not reason,
            reason=reason,
            T_world_camera=self._chain.T_world_last.copy(),
            T_reference_camera=link.T_last_camera,
            covariance=link.covariance,
            features=len(evidence.keypoints_px),
            matches=len(evidence.matches_px),
            inliers=int(evidence.inlier.sum()),
            restarted=restarted,
            evidence=evidence,
        )
