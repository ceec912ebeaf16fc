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
from vo_service.mapping.places.map_file import read_map, write_map
from vo_service.outputs.output import PoseUpdate
from vo_service.settings import MapSettings

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

    def frame(self, number: int) -> RgbdFrame:
        """One of them."""
        return tour_frame(self.config, number, self.film(number))


@dataclass(frozen=True)
class Outcome:
    """One start of the second day.

    frames   until it was known where the camera is, both ends counted; None: never
    away_m, away_deg  how far from there the map says that it is, at that moment
    later_m, later_deg  the most of that, from then on
    """

    frames: int | None
    away_m: float
    away_deg: float
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
    runner = LoopRunner(method, InlineLoops(closer_in(read_map(file), MapSettings())))
    off: list[tuple[float, float]] = []
    seen = 0
    while seen < min(LONGEST, len(tour.T_room_camera) - first) and len(off) <= LATER:
        told = _follow(runner, tour.frame(first + seen))
        known = runner.map.snapshot
        if known.is_located and told.estimate.ok:
            T_room_camera = T_room_map @ known.T_map_odom @ told.T_odom_camera
            off_m, off_rad = apart(tour.T_room_camera[first + seen], T_room_camera)
            off.append((off_m, math.degrees(off_rad)))
        seen += 1
    if not off:
        return Outcome(None, 0.0, 0.0, 0.0, 0.0)
    later_m, later_deg = np.max(off, axis=0)
    return Outcome(seen - len(off) + 1, *off[0], float(later_m), float(later_deg))


def _follow(runner: LoopRunner, frame: RgbdFrame) -> PoseUpdate:
    runner.frame(frame)
    runner.learn()
    assert runner.told is not None
    return runner.told
