"""Dense odometry against keyframes: the brightness and depth of a frame, laid on those of another.

Kerl, Sturm and Cremers, "Dense Visual SLAM for RGB-D Cameras" (IROS 2013) for the keyframes; Kerl,
Stueckler and Cremers, "Dense Continuous-Time Tracking and Mapping with Rolling Shutter RGB-D
Cameras" (ICCV 2015) for the time of each row. SURF finds the camera again where that fails.
"""

from dataclasses import dataclass

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from vo_service.odometry.keyframe.alignment import STANDING, align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.certainty import Certainty, certainty
from vo_service.odometry.keyframe.confidence import cover, doubt, lack
from vo_service.odometry.keyframe.drawing import draw, draw_points
from vo_service.odometry.keyframe.falloff import Falloff
from vo_service.odometry.keyframe.first_keyframe import made_anew
from vo_service.odometry.keyframe.good_frame import GoodFrame
from vo_service.odometry.keyframe.images import Images, make_images
from vo_service.odometry.keyframe.local_map import Keyframe, LocalMap, make_keyframe
from vo_service.odometry.keyframe.movement import at_rest
from vo_service.odometry.keyframe.next_keyframe import choose, is_due, settle
from vo_service.odometry.keyframe.parameters import FEWEST_POINTS, PATIENCE_FRAMES
from vo_service.odometry.keyframe.plain_view import carried_on
from vo_service.odometry.keyframe.recovery import Found, Recovery, doubted
from vo_service.odometry.keyframe.second_look import look_again
from vo_service.odometry.keyframe.steadiness import steadied
from vo_service.odometry.keyframe.way import SAME_LIGHT, Way
from vo_service.odometry.stopwatch import NullStopwatch, Stopwatch
from vo_service.odometry.surf import SurfExtractor
from vo_service.types import Estimate, Evidence

# After so many frames without a pose, tracking begins anew; after fewer where none has been laid on
# the first keyframe yet, which a fast turn may have bent.
MOST_FAILURES_AT_FIRST, MOST_FAILURES = PATIENCE_FRAMES


@dataclass(frozen=True)
class Track:
    """What is followed: a keyframe, and the way of the camera up to the last good frame.

    T_world_reference  4x4 pose of the frame from which on the keyframe has been in use
    is_first           the keyframe is the very first frame, and the camera's velocity not known
    last               the last good frame, from the second on
    clarity            of the keyframe's first view, see `Certainty`; None before that
    """

    keyframe: Keyframe
    way: Way
    T_world_reference: Array
    is_first: bool = False
    last: GoodFrame | None = None
    clarity: float | None = None

    def clarity_at_first(self, found: Found, sure: Certainty) -> float:
        """Of the first view of the keyframe that was found: this one, if it was not in use."""
        if self.clarity is None or found.keyframe is not self.keyframe:
            return sure.clarity
        return self.clarity


class KeyframeOdometry:
    """Frames are laid on a keyframe, which stays as long as most of it is in view.

    World is the first good camera. A frame that fails is left out.
    """

    def __init__(
        self, extractor: SurfExtractor | None = None, stopwatch: Stopwatch | None = None
    ) -> None:
        self._stopwatch = stopwatch or NullStopwatch()
        self._recovery = Recovery(extractor or SurfExtractor())
        self._map = LocalMap()
        self._falloff = Falloff()
        self._track: Track | None = None
        self._T_world_camera = np.eye(4)
        self._failures = 0

    @property
    def falloff(self) -> float:
        """Of the lens's light towards the corners, as it is known now: see `Falloff`."""
        return self._falloff.value

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is, from this frame and the keyframe."""
        # Brightness in four sizes, and inverse depth.
        with self._stopwatch.stage("images"):
            images = make_images(frame, self.falloff)
        if self._track is None:
            return self._start(frame, images, restarted=False)
        # The keyframe's points, laid on this frame from where they are expected.
        with self._stopwatch.stage("align"):
            found = self._align(images, self._track)
        # Does it fit, and was it expected there? Else features, depth alone.
        if found.is_better_tried_again or self._track.way.is_long_ago(images.stamp_s):
            with self._stopwatch.stage("recovery"):
                found = self._recovery.find(frame, images, found, self._track.way, self._map)
        # The shutter bent a first keyframe, while the velocity was not known: now it is.
        found = self._with_first_unbent(images, found, self._track)
        if reason := doubted(found.alignment, self._track.way, images) or cover(found.alignment):
            return self._fail(frame, images, self._track, found, reason)
        # Does what is in view hold the camera in all six directions?
        with self._stopwatch.stage("certainty"):
            agitation = self._track.way.agitation_with(found.alignment.camera_velocity)
            sure = certainty(found.keyframe.points, images, found.alignment, found.tie, agitation)
        if sure.doubt:
            if not self._track.way.is_held(images.stamp_s):
                return self._fail(frame, images, self._track, found, sure.doubt)
            # For a moment, it goes on as it moved.
            found, sure = carried_on(found, sure, self._track.way, images.stamp_s)
        elif self._track.way.is_carried_on:
            # From there to where it is found is no way that the camera went.
            found = found.moved(found.T_world_camera, self._track.way.velocity)
        # A calm camera's pose is that of many frames.
        found, unrest = steadied(found, sure.covariance, self._track.way, images.stamp_s)
        # When the keyframe goes out of view, the pose is settled with others, and the next begins.
        good = GoodFrame(frame, images, found, self._track.way, is_held=not sure.doubt)
        keyframe = found.keyframe
        if is_due(good, sure.clarity, self._track.clarity_at_first(found, sure)):
            self._falloff = self._falloff.with_view(keyframe, images, found.alignment)
            good = good.with_falloff(self.falloff)
            with self._stopwatch.stage("settle"):
                settled, good = settle(self._track.last, good, self._map)
            with self._stopwatch.stage("keyframe"):
                keyframe = choose(settled, self._map)
        return self._advance(self._track, good, sure, keyframe, unrest)

    def _align(self, images: Images, track: Track) -> Found:
        keyframe, way = track.keyframe, track.way
        starts = way.starts(keyframe.T_world_keyframe, images.stamp_s)
        tie = way.tie(keyframe.T_world_keyframe, images.stamp_s)
        light = way.light_at(images)
        found = Found(
            keyframe, align(keyframe.points, images, starts, tie, light, all_alike()), tie
        )
        return found if track.is_first else look_again(found, images, way)

    def _with_first_unbent(self, images: Images, found: Found, track: Track) -> Found:
        """The same; on the first keyframe of a rolling shutter, made anew by the velocity."""
        if not track.is_first or images.shutter.is_instant or doubt(found.alignment):
            return found
        found = made_anew(found, images, track.way)
        self._map.begin(found.keyframe)
        return found

    def _start(self, frame: RgbdFrame, images: Images, restarted: bool) -> Estimate:
        """Make this frame the first keyframe, if it has enough points to be laid on others."""
        keyframe = make_keyframe(frame, images, self._T_world_camera, at_rest(), ALL_STILL)
        evidence = Evidence(keypoints_px=draw_points(keyframe))
        if reason := self._why_no_start(keyframe, images):
            return self._estimate(False, f"cannot start: {reason}", evidence)
        self._map.begin(keyframe)
        way = Way(
            self._T_world_camera,
            np.zeros(6),
            images.stamp_s,
            SAME_LIGHT,
            images.mean_brightness,
            held_s=images.stamp_s,
        )
        self._track = Track(keyframe, way, self._T_world_camera, is_first=True)
        self._failures = 0
        return self._estimate(True, "", evidence, restarted=restarted)

    def _why_no_start(self, keyframe: Keyframe, images: Images) -> str:
        """Why a frame is no good first keyframe: the next ones could not be laid on it."""
        if len(keyframe.points[0]) < 2 * FEWEST_POINTS:
            return f"only {len(keyframe.points[0])} points with depth"
        itself = align(keyframe.points, images, [np.eye(4)], STANDING, SAME_LIGHT, all_alike())
        return (
            doubt(itself) or certainty(keyframe.points, images, itself, STANDING, np.zeros(2)).doubt
        )

    def _fail(
        self, frame: RgbdFrame, images: Images, track: Track, found: Found, reason: str
    ) -> Estimate:
        """Hold the pose; after too many failures give the keyframes up."""
        self._failures += 1
        if self._failures > (MOST_FAILURES_AT_FIRST if track.is_first else MOST_FAILURES):
            return self._start(frame, images, restarted=True)
        return self._estimate(False, reason, draw(found.keyframe, found.alignment))

    def _advance(
        self, track: Track, good: GoodFrame, sure: Certainty, keyframe: Keyframe, unrest: float
    ) -> Estimate:
        """Go on from here, with this keyframe."""
        images, found = good.images, good.found
        is_next_reference = keyframe is not track.keyframe
        way = track.way.on(
            found.T_world_camera,
            found.alignment.camera_velocity,
            images,
            found.alignment.light if keyframe is found.keyframe else SAME_LIGHT,
            unrest,
            images.stamp_s if good.is_held else track.way.held_s,
        )
        T_reference_camera = inverse(track.T_world_reference) @ found.T_world_camera
        T_world_reference = found.T_world_camera if is_next_reference else track.T_world_reference
        self._T_world_camera = found.T_world_camera
        clarity = track.clarity_at_first(found, sure) if keyframe is found.keyframe else None
        self._track = Track(keyframe, way, T_world_reference, last=good, clarity=clarity)
        self._failures = 0
        return self._estimate(
            True,
            found.lack or lack(found.alignment),
            draw(found.keyframe, found.alignment),
            T_reference_camera,
            sure.covariance,
            is_next_reference=is_next_reference,
        )

    def _estimate(
        self,
        ok: bool,
        reason: str,
        evidence: Evidence,
        T_reference_camera: Array | None = None,
        covariance: Array | None = None,
        restarted: bool = False,
        is_next_reference: bool = True,
    ) -> Estimate:
        return Estimate(
            ok=ok,
            reason=reason,
            T_world_camera=self._T_world_camera.copy(),
            T_reference_camera=np.eye(4) if T_reference_camera is None else T_reference_camera,
            covariance=np.zeros((6, 6)) if covariance is None else covariance,
            features=len(evidence.keypoints_px),
            matches=len(evidence.matches_px),
            inliers=int(evidence.inlier.sum()),
            restarted=restarted,
            is_next_reference=is_next_reference,
            evidence=evidence,
        )
