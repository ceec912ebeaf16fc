"""A map of one half of a tour, kept in a file; and the camera, started anew in the other half."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.runners import LoopRunner
from benchmarks.tour_frames import tour_frame
from drivers.camera import RgbdFrame
from drivers.geometry import Array, apart, inverse
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import Source
from vo_service.evaluation.gross_errors import GROSS_DEG, GROSS_M
from vo_service.mapping.loops.inline import InlineLoops
from vo_service.mapping.loops.opening import closer_in, open_inline_loops
from vo_service.mapping.places.map_file import MapContents, read_map, write_map
from vo_service.mapping.spacing import steps_between
from vo_service.settings import MapSettings
from vo_service.types import PoseUpdate

# Frames of the second day at most, and those after it is known where the camera is.
LONGEST, LATER = 300, 30


@dataclass(frozen=True)
class Tour:
    """A film and the truth of it: T_room_camera (N, 4, 4)."""

    config: SyntheticConfig
    film: Source
    T_room_camera: Array

    @property
    def noon(self) -> int:
        """The first frame of the second half."""
        return len(self.T_room_camera) // 2

    def lies_at(self, contents: MapContents, T_map_camera: Array) -> Array:
        """4x4 T_room_map, by the place of a map of this tour that is nearest to a camera."""
        T_map_place = np.array([node.T_map_place for node in contents.nodes])
        nearest = int(np.argmin(steps_between(T_map_camera, T_map_place)))
        number = round(contents.places[nearest].stamp_s * self.config.rate_hz)
        return np.asarray(self.T_room_camera[number] @ inverse(T_map_place[nearest]))

    def frame(self, number: int) -> RgbdFrame:
        """One of them."""
        return tour_frame(self.config, number, self.film(number))


@dataclass(frozen=True)
class Outcome:
    """One start of the second day.

    frames   until it was known where the camera is, both ends counted; None: never
    away_m, away_deg  how far from there the map says that it is, at that moment
    near_m      the same, as seen from the nearest place of the first day: without what the map
                itself is off by, a lap long
    later_m, later_deg  the most of the first, from then on
    """

    frames: int | None
    away_m: float
    away_deg: float
    near_m: float
    later_m: float
    later_deg: float

    @property
    def is_wrong(self) -> bool:
        """Whether that is a gross error."""
        return self.later_m > GROSS_M or self.later_deg > GROSS_DEG


def first_day(method: str, tour: Tour, file: Path) -> Array:
    """Write the map of the first half; 4x4 T_room_map, where it lies."""
    runner = LoopRunner(method, open_inline_loops(MapSettings()))
    T_room_map = np.eye(4)
    for number in range(tour.noon):
        told = _follow(runner, tour.frame(number))
        if number == 0:
            T_room_map = tour.T_room_camera[0] @ inverse(told.T_odom_camera)
    runner.map.close()
    write_map(file, runner.map.closer.contents)
    return np.asarray(T_room_map)


def second_day(method: str, tour: Tour, file: Path, T_room_map: Array, first: int) -> Outcome:
    """Begin at frame `first` with the map of the file. Raises InputError if that is no map."""
    contents = read_map(file)
    runner = LoopRunner(method, InlineLoops(closer_in(contents, MapSettings())))
    off: list[tuple[float, float]] = []
    seen, near_m = 0, 0.0
    while seen < min(LONGEST, len(tour.T_room_camera) - first) and len(off) <= LATER:
        told = _follow(runner, tour.frame(first + seen))
        known = runner.map.snapshot
        if known.is_located and told.estimate.ok:
            T_map_camera = known.T_map_odom @ told.T_odom_camera
            truth = tour.T_room_camera[first + seen]
            off_m, off_rad = apart(truth, T_room_map @ T_map_camera)
            if not off:
                near_m, _ = apart(truth, tour.lies_at(contents, T_map_camera) @ T_map_camera)
            off.append((off_m, math.degrees(off_rad)))
        seen += 1
    if not off:
        return Outcome(None, 0.0, 0.0, 0.0, 0.0, 0.0)
    later_m, later_deg = np.max(off, axis=0)
    return Outcome(seen - len(off) + 1, *off[0], near_m, float(later_m), float(later_deg))


def _follow(runner: LoopRunner, frame: RgbdFrame) -> PoseUpdate:
    runner.frame(frame)
    runner.learn()
    assert runner.told is not None
    return runner.told
