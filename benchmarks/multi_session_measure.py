"""A map of one half of a tour, kept in a file; and the camera, started anew in the other half."""

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

# Frames of the second day at most, and those after it is known where the camera is.
MAX_FRAMES, SETTLE_FRAMES = 300, 30


@dataclass(frozen=True)
class TourSequence:
    """A film and the truth of it: T_room_camera (N, 4, 4)."""

    config: SyntheticConfig
    images: ImageSource
    T_room_camera: Array

    @property
    def second_half_start(self) -> int:
        """The first frame of the second half."""
        return len(self.T_room_camera) // 2

    def T_room_map_near(self, contents: MapContents, T_map_camera: Array) -> Array:
        """4x4 T_room_map, by the place of a map of this tour that is nearest to a camera."""
        T_map_place = np.array([node.T_map_keyframe for node in contents.nodes])
        nearest = int(np.argmin(pose_distance_steps(T_map_camera, T_map_place)))
        number = round(contents.keyframes[nearest].stamp_s * self.config.rate_hz)
        return np.asarray(self.T_room_camera[number] @ inverse(T_map_place[nearest]))

    def frame(self, number: int) -> RgbdFrame:
        """One of them."""
        return make_tour_frame(self.config, number, self.images(number))


@dataclass(frozen=True)
class SessionStartResult:
    """One start of the second day.

    frames   until it was known where the camera is, both ends counted; None: never
    away_m, away_deg  how far from there the map says that it is, at that moment
    near_m      the same, as seen from the nearest place of the first day: without what the map
                itself is off by, a lap long
    later_m, later_deg  the most of the first, from then on
    """

    frames: int | None
    error_m: float
    error_deg: float
    nearby_error_m: float
    settled_error_m: float
    settled_error_deg: float

    @property
    def is_wrong(self) -> bool:
        """Whether that is a gross error."""
        return self.settled_error_m > GROSS_ERROR_M or self.settled_error_deg > GROSS_ERROR_DEG


def build_map(method: str, tour: TourSequence, file: Path) -> Array:
    """Write the map of the first half; 4x4 T_room_map, where it lies."""
    runner = LoopClosureRunner(method, create_synchronous_loop_closure(MapConfig()))
    T_room_map = np.eye(4)
    for number in range(tour.second_half_start):
        told = _track_frame(runner, tour.frame(number))
        if number == 0:
            T_room_map = tour.T_room_camera[0] @ inverse(told.T_odom_camera)
    runner.map.close()
    write_map(file, runner.map.loop_closer.contents)
    return np.asarray(T_room_map)


def relocalize_in_map(
    method: str, tour: TourSequence, file: Path, T_room_map: Array, first: int
) -> SessionStartResult:
    """Begin at frame `first` with the map of the file. Raises InputError if that is no map."""
    contents = read_map(file)
    runner = LoopClosureRunner(
        method, SynchronousLoopClosure(create_loop_closer_from_map(contents, MapConfig()))
    )
    off: list[tuple[float, float]] = []
    seen, near_m = 0, 0.0
    while seen < min(MAX_FRAMES, len(tour.T_room_camera) - first) and len(off) <= SETTLE_FRAMES:
        told = _track_frame(runner, tour.frame(first + seen))
        known = runner.map.snapshot
        if known.is_localized and told.estimate.ok:
            T_map_camera = known.T_map_odom @ told.T_odom_camera
            truth = tour.T_room_camera[first + seen]
            off_m, off_rad = pose_distance(truth, T_room_map @ T_map_camera)
            if not off:
                near_m, _ = pose_distance(
                    truth, tour.T_room_map_near(contents, T_map_camera) @ T_map_camera
                )
            off.append((off_m, math.degrees(off_rad)))
        seen += 1
    if not off:
        return SessionStartResult(None, 0.0, 0.0, 0.0, 0.0, 0.0)
    later_m, later_deg = np.max(off, axis=0)
    return SessionStartResult(
        seen - len(off) + 1, *off[0], near_m, float(later_m), float(later_deg)
    )


def _track_frame(runner: LoopClosureRunner, frame: RgbdFrame) -> OdometryUpdate:
    runner.estimate_pose(frame)
    runner.update_map()
    assert runner.told is not None
    return runner.told
