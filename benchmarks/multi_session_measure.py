"""A saved map of one half of a tour, and relocalization in it from the other half."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.runners import LoopClosureRunner
from benchmarks.tour_frames import make_tour_frame
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, pose_distance
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.fault_injection import ImageSource
from vo_service.config_tables import MapConfig
from vo_service.slam.keyframe_selector import pose_distance_steps
from vo_service.slam.loop_closure.factory import (
    create_loop_closer_from_map,
    create_synchronous_loop_closure,
)
from vo_service.slam.loop_closure.synchronous_loop_closure import SynchronousLoopClosure
from vo_service.slam.saved_maps.map_file import MapContents, read_map, write_map
from vo_service.tools.evaluation.gross_errors import GROSS_ERROR_DEG, GROSS_ERROR_M
from vo_service.types import OdometryUpdate

# Most frames of a start in the second session, and frames after its relocalization.
MAX_FRAMES, SETTLE_FRAMES = 300, 30


@dataclass(frozen=True)
class TourSequence:
    """A rendered sequence and its true poses T_room_camera (N, 4, 4)."""

    config: SyntheticConfig
    images: ImageSource
    T_room_camera: Array

    @property
    def second_half_start(self) -> int:
        """The first frame of the second half."""
        return len(self.T_room_camera) // 2

    def T_room_map_near(self, contents: MapContents, T_map_camera: Array) -> Array:
        """T_room_map (4, 4) by the keyframe of a map of this tour that is nearest to a camera."""
        T_map_keyframe = np.array([node.T_map_keyframe for node in contents.nodes])
        nearest = int(np.argmin(pose_distance_steps(T_map_camera, T_map_keyframe)))
        number = round(contents.keyframes[nearest].stamp_s * self.config.rate_hz)
        return np.asarray(self.T_room_camera[number] @ inverse(T_map_keyframe[nearest]))

    def frame(self, number: int) -> RgbdFrame:
        """Read a frame."""
        return make_tour_frame(self.config, number, self.images(number))


@dataclass(frozen=True)
class SessionStartResult:
    """Result of one start in the second session.

    Attributes:
        frames: Frames until the relocalization, both ends counted; None if there was none.
        error_m: Error of the position in the map at that time.
        error_deg: Error of the rotation.
        nearby_error_m: Error relative to the nearest keyframe, without the map's own error.
        settled_error_m: Largest position error from then on.
        settled_error_deg: Largest rotation error from then on.
    """

    frames: int | None
    error_m: float
    error_deg: float
    nearby_error_m: float
    settled_error_m: float
    settled_error_deg: float

    @property
    def is_wrong(self) -> bool:
        """Whether the settled error is a gross error."""
        return self.settled_error_m > GROSS_ERROR_M or self.settled_error_deg > GROSS_ERROR_DEG


def build_map(method: str, tour: TourSequence, file: Path) -> Array:
    """Save the map of the first half; return T_room_map (4, 4)."""
    runner = LoopClosureRunner(method, create_synchronous_loop_closure(MapConfig()))
    T_room_map = np.eye(4)
    for number in range(tour.second_half_start):
        update = _track_frame(runner, tour.frame(number))
        if number == 0:
            T_room_map = tour.T_room_camera[0] @ inverse(update.T_odom_camera)
    runner.map.close()
    write_map(file, runner.map.loop_closer.contents)
    return np.asarray(T_room_map)


def relocalize_in_map(
    method: str, tour: TourSequence, file: Path, T_room_map: Array, first: int
) -> SessionStartResult:
    """Start at frame `first` with the map of a file. Raises InputError if it is not a map."""
    contents = read_map(file)
    runner = LoopClosureRunner(
        method, SynchronousLoopClosure(create_loop_closer_from_map(contents, MapConfig()))
    )
    errors: list[tuple[float, float]] = []
    count, nearby_m = 0, 0.0
    max_count = min(MAX_FRAMES, len(tour.T_room_camera) - first)
    while count < max_count and len(errors) <= SETTLE_FRAMES:
        update = _track_frame(runner, tour.frame(first + count))
        snapshot = runner.map.snapshot
        if snapshot.is_localized and update.estimate.ok:
            T_map_camera = snapshot.T_map_odom @ update.T_odom_camera
            truth = tour.T_room_camera[first + count]
            error_m, error_rad = pose_distance(truth, T_room_map @ T_map_camera)
            if not errors:
                nearby_m, _ = pose_distance(
                    truth, tour.T_room_map_near(contents, T_map_camera) @ T_map_camera
                )
            errors.append((error_m, math.degrees(error_rad)))
        count += 1
    if not errors:
        return SessionStartResult(None, 0.0, 0.0, 0.0, 0.0, 0.0)
    settled_m, settled_deg = np.max(errors, axis=0)
    return SessionStartResult(
        count - len(errors) + 1, *errors[0], nearby_m, float(settled_m), float(settled_deg)
    )


def _track_frame(runner: LoopClosureRunner, frame: RgbdFrame) -> OdometryUpdate:
    runner.estimate_pose(frame)
    runner.update_map()
    assert runner.last_update is not None
    return runner.last_update
