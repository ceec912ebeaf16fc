"""A loop closer with scripted recognition results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.slam.keyframe_database import (
    TRACKED_VELOCITY_SIGMA,
    KeyframeDatabase,
    MapKeyframe,
    QueryFrame,
)
from vo_service.slam.keyframe_selection import OdometryConstraint
from vo_service.slam.loop_closer import KeyframeObservation, LoopCloser
from vo_service.slam.place_recognizer import (
    NO_POSES,
    KeyframePoses,
    PlaceMatch,
    PlaceRecognizer,
)
from vo_service.slam.pose_graph import PoseGraph

ODOMETRY_COVARIANCE, LOOP_COVARIANCE = np.eye(6) * 1e-5, np.eye(6) * 1e-6
STEP_M, VELOCITY = 0.3, np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0])


@cache
def make_frame() -> RgbdFrame:
    """The frame of all views."""
    return render_corner(np.eye(4))


@cache
def _described_corner() -> tuple[PlaceRecognizer, QueryFrame]:
    real = PlaceRecognizer()
    return real, real.create_query(make_frame(), np.zeros(6))


@dataclass
class ScriptedRecognizer(PlaceRecognizer):
    """Recognizer with scripted matches; all views look the same.

    Attributes:
        matches: 4x4 T_keyframe_camera by the keyframe's number.
        rejects_multiple: Whether several matches are rejected.
        velocity: Of the last query, with its sigma.
        T_map_keyframe: Argument of the last `recognize`.
    """

    matches: Mapping[int, Array] = field(default_factory=dict)
    rejects_multiple: bool = False
    velocity: tuple[Array, tuple[float, float]] = field(default=(VELOCITY, TRACKED_VELOCITY_SIGMA))
    T_map_keyframe: KeyframePoses = field(default_factory=lambda: NO_POSES)

    def create_query(
        self,
        frame: RgbdFrame,
        velocity: Array,
        velocity_sigma: tuple[float, float] = TRACKED_VELOCITY_SIGMA,
    ) -> QueryFrame:
        self.velocity = velocity, velocity_sigma
        return _described_corner()[1]

    def create_keyframe(
        self, view: QueryFrame, number: int, world: int, T_world_place: Array
    ) -> MapKeyframe:
        return replace(
            _corner_keyframe(), number=number, world_id=world, T_world_keyframe=T_world_place
        )

    def recognize(
        self,
        view: QueryFrame,
        keyframes: Sequence[MapKeyframe],
        T_map_keyframe: KeyframePoses = NO_POSES,
    ) -> PlaceMatch | None:
        self.T_map_place = T_map_keyframe
        shown = [keyframe.number for keyframe in keyframes if keyframe.number in self.matches]
        if not shown or (self.rejects_multiple and len(shown) > 1):
            return None
        return PlaceMatch(shown[0], self.matches[shown[0]], LOOP_COVARIANCE, 50)


@cache
def _corner_keyframe() -> MapKeyframe:
    real, view = _described_corner()
    return real.create_keyframe(view, 0, 0, np.eye(4))


def make_loop_closer(max_keyframes: int = 1000) -> tuple[LoopCloser, ScriptedRecognizer]:
    """A loop closer with an empty map of limited size."""
    scripted = ScriptedRecognizer()
    keyframes = KeyframeDatabase(max_bytes=max_keyframes * _corner_keyframe().size_bytes)
    return LoopCloser(scripted, keyframes, PoseGraph()), scripted


def pose_ahead(distance_m: float) -> Array:
    return rigid_transform(np.eye(3), [0.0, 0.0, distance_m])


def make_observation(distance_m: float, world: int = 0) -> KeyframeObservation:
    """An observation of a camera that moves straight ahead."""
    return KeyframeObservation(
        make_frame(),
        world,
        pose_ahead(distance_m),
        OdometryConstraint(VELOCITY, ODOMETRY_COVARIANCE, STEP_M),
    )


def closer_after_walk(error_m: float, steps: int = 9) -> tuple[LoopCloser, ScriptedRecognizer]:
    """A straight walk, whose last keyframe matches the first one with an error of the odometry."""
    made, scripted = make_loop_closer()
    for step in range(steps):
        made.process_keyframe(make_observation(STEP_M * step))
    scripted.matches = {0: pose_ahead(STEP_M * steps + error_m)}
    made.process_keyframe(make_observation(STEP_M * steps))
    scripted.matches = {}
    return made, scripted
