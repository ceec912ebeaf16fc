"""What else is tried with a frame that does not fit the keyframe, or may fit it by chance."""

from dataclasses import dataclass, replace
from itertools import islice
from math import log

from drivers.camera import RgbdFrame
from drivers.geometry import Array, adjoint, inverse
from vo_service.odometry.keyframe.alignment import Alignment, Tie, align, all_alike, depth_alone
from vo_service.odometry.keyframe.confidence import doubt, doubt_anywhere, misfit, oddness
from vo_service.odometry.keyframe.features import FeatureSearch
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.local_map import Keyframe, LocalMap
from vo_service.odometry.keyframe.movement import ACCELERATION
from vo_service.odometry.keyframe.parameters import KEYFRAMES, OTHER_LIGHT, PATIENCE_FRAMES, SLIGHT
from vo_service.odometry.keyframe.way import Way
from vo_service.odometry.surf import SurfExtractor

# So many are searched for features, and so many that are found are followed up: a thing that moves
# may be seen in the best of them.
_, MOST_SIGHTINGS, SEARCHED_KEYFRAMES, _ = KEYFRAMES
# After a try that changed nothing, so many odd frames are taken as they are.
REST_FRAMES = PATIENCE_FRAMES[0]


@dataclass(frozen=True)
class Found:
    """An alignment, of which keyframe, and what it had to do without ("" = nothing)."""

    keyframe: Keyframe
    alignment: Alignment
    tie: Tie
    lack: str = ""

    @property
    def T_world_camera(self) -> Array:
        """4x4 pose of the camera."""
        return self.keyframe.T_world_keyframe @ inverse(self.alignment.T_camera_keyframe)

    def moved(self, T_world_camera: Array, velocity: Array) -> "Found":
        """The same with another pose (4x4) and velocity (6,) of the camera in its own axes."""
        T_camera_keyframe = inverse(T_world_camera) @ self.keyframe.T_world_keyframe
        movement = self.alignment.movement.copy()
        movement[:ACCELERATION] = -adjoint(inverse(T_camera_keyframe)) @ velocity
        moved = replace(self.alignment, T_camera_keyframe=T_camera_keyframe, movement=movement)
        return replace(self, alignment=moved)

    @property
    def is_better_tried_again(self) -> bool:
        """Whether it is odd or not to be believed."""
        return oddness(self.alignment) > 1.0 or bool(doubt(self.alignment))


class Recovery:
    """Two more ways: features, and depth alone."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.features = FeatureSearch(extractor)
        self._rest = 0

    def find(
        self, frame: RgbdFrame, images: Images, first: Found, way: Way, local_map: LocalMap
    ) -> Found:
        """The first try, or what is clearly better."""
        if self._rest > 0 and not way.is_long_ago(images.stamp_s):
            self._rest -= 1
            found = self._by_depth(images, first, way) if doubt(first.alignment) else first
            if not doubt(found.alignment):
                return found
        found = self._by_features(frame, images, first, way, local_map)
        if doubt(found.alignment):
            found = self._by_depth(images, found, way)
        self._rest = REST_FRAMES if found is first or found.lack else 0
        return found

    def _by_features(
        self, frame: RgbdFrame, images: Images, best: Found, way: Way, local_map: LocalMap
    ) -> Found:
        """The keyframe in use first, then those that were in use last."""
        others = [k for k in reversed(local_map.keyframes) if k is not best.keyframe]
        keyframes = [best.keyframe, *others][:SEARCHED_KEYFRAMES]
        for sighting in islice(self.features.find(frame, keyframes), MOST_SIGHTINGS):
            keyframe = sighting.keyframe
            tie = way.tie(keyframe.T_world_keyframe, images.stamp_s)
            start, light = sighting.T_camera_keyframe, (images.light_against(keyframe.images), 0.0)
            again = align(keyframe.points, images, [start], tie, light, all_alike())
            if _is_better(again, best.alignment):
                best = Found(keyframe, again, tie)
            if not doubted(again, way, images):
                break
        return best

    def _by_depth(self, images: Images, best: Found, way: Way) -> Found:
        """Without brightness, where the light is quite another: it may be dark.

        In the same light, brightness that does not fit says that the depth is wrong as well. Where
        the camera may be anywhere by now, shapes alone say little: many places have the same.
        """
        keyframe, tie = best.keyframe, best.tie
        is_anywhere = not way.is_soon(images.stamp_s)
        if is_anywhere or not is_other_light(images.light_against(keyframe.images)):
            return best
        starts = way.starts(keyframe.T_world_keyframe, images.stamp_s)
        again = align(keyframe.points, images, starts, tie, (1.0, 0.0), depth_alone())
        if doubt(again):
            return best
        return Found(keyframe, again, tie, lack=f"by depth alone: {doubt(best.alignment)}")


def doubted(found: Alignment, way: Way, images: Images) -> str:
    """Why an alignment is not to be believed, by how long ago it was known where the camera is."""
    return doubt(found) if way.is_soon(images.stamp_s) else doubt_anywhere(found)


def is_other_light(ratio: float) -> bool:
    """Whether one view is so many times as bright as another that the light must have changed."""
    return abs(log(ratio)) > log(OTHER_LIGHT)


def _is_better(another: Alignment, best: Alignment) -> bool:
    if bool(doubt(another)) != bool(doubt(best)):
        return not doubt(another)
    return misfit(another) < (1.0 - SLIGHT) * misfit(best)
