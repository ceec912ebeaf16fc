"""Relocalization of a restarted robot in the map of an earlier session.

The first session is the first half of a tour of a minute; its map is saved to a file. In the second
session the map is loaded and the odometry starts in the other half, which passes the same places on
another path. There are --starts evenly spread starts of ten seconds at most. Each seed is another
room; its frames (2.8 GB) are shared with `benchmarks.relocalization` if FOLDER is the same. Results
are stored in FOLDER/results.json; remove that file to measure again.

"known" counts the starts that relocalize, and "frames" is the median time until then. "median" and
"largest" (mm, degrees) are errors in the saved map at that time, including the map's own error.
"a second later" is the largest error within the next second. "wrong" is above 5 cm or 3 degrees.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.harness import Json, ResultCache, Table, known_median, option
from benchmarks.relocalization import TourSequence
from benchmarks.tours import LoopClosureRunner
from benchmarks.tracking import METHOD, is_gross, pose_error
from drivers.core.geometry import Array, inverse
from vo_service.config_tables import MapConfig
from vo_service.odometry.warm_up import warm_up
from vo_service.slam.map_file import read_map, write_map
from vo_service.slam.synchronous_loop_closure import (
    SynchronousLoopClosure,
    create_loop_closer_from_map,
)
from vo_service.terminal import Terminal

# Most frames of a start in the second session, and frames after its relocalization.
MAX_FRAMES, SETTLE_FRAMES = 300, 30
TABLE = Table(
    *(12, "starts:8d", "known:8d", "wrong:8d", "frames:8.0f", "median:9.1mm", "largest:9.1mm"),
    *("deg:7.2f", "a second later:16.1mm", "deg:7.2f"),
)


@dataclass(frozen=True)
class SessionStartResult:
    """Result of one start in the second session.

    Attributes:
        frames: Frames until the relocalization, both ends counted; None if there was none.
        error_m: Error of the position in the map at that time.
        error_deg: Error of the rotation.
        settled_error_m: Largest position error from then on.
        settled_error_deg: Largest rotation error from then on.
    """

    frames: int | None
    error_m: float
    error_deg: float
    settled_error_m: float
    settled_error_deg: float

    @property
    def is_wrong(self) -> bool:
        """Whether the settled error is a gross error."""
        return is_gross(self.settled_error_m, self.settled_error_deg)


def second_half_start(tour: TourSequence) -> int:
    """The first frame of the second half."""
    return len(tour.T_room_camera) // 2


def build_map(method: str, tour: TourSequence, file: Path) -> Array:
    """Save the map of the first half; return T_room_map (4, 4)."""
    runner = LoopClosureRunner(method)
    T_room_map = np.eye(4)
    for number in range(second_half_start(tour)):
        update = runner.process(tour.frame(number))
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
    count = 0
    max_count = min(MAX_FRAMES, len(tour.T_room_camera) - first)
    while count < max_count and len(errors) <= SETTLE_FRAMES:
        update = runner.process(tour.frame(first + count))
        snapshot = runner.map.snapshot
        if snapshot.is_localized and update.estimate.ok:
            T_map_camera = snapshot.T_map_odom @ update.T_odom_camera
            truth = tour.T_room_camera[first + count]
            errors.append(pose_error(truth, T_room_map @ T_map_camera))
        count += 1
    if not errors:
        return SessionStartResult(None, 0.0, 0.0, 0.0, 0.0)
    settled_m, settled_deg = np.max(errors, axis=0)
    return SessionStartResult(
        count - len(errors) + 1, *errors[0], float(settled_m), float(settled_deg)
    )


@option("folder", type=Path, help="folder of rendered frames, maps and results")
@option("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
@option("--starts", type=int, default=20, help="starts of each seed")
@METHOD
def main(args: argparse.Namespace) -> None:
    """Run the seeds without stored results, and print all."""
    cache, together = ResultCache(args.folder), list[SessionStartResult]()
    warm_up(args.method, lambda stage: None)
    print(TABLE.head)
    for seed in args.seeds:
        name = f"next-day-{seed}-{args.method}-{args.starts}"
        result = cache.get_or_run(name, partial(_measure, args, seed))
        outcomes = [SessionStartResult(**each) for each in result["outcomes"]]
        together += outcomes
        print(format_row(f"seed {seed}", outcomes), flush=True)
    print(format_row("together", together))


def _measure(args: argparse.Namespace, seed: int) -> Json:
    terminal = Terminal()
    tour = TourSequence.open(args.folder, seed, terminal)
    file = args.folder / f"day-{seed}.keyframes"
    T_room_map = build_map(args.method, tour, file)
    last = len(tour.T_room_camera) - MAX_FRAMES
    starts = np.linspace(second_half_start(tour), last, args.starts, dtype=np.int64)
    outcomes = []
    for number, first in enumerate(starts, 1):
        terminal.progress(f"room {seed}: start", number, args.starts)
        outcomes.append(relocalize_in_map(args.method, tour, file, T_room_map, int(first)))
    terminal.clear()
    return {"outcomes": [asdict(each) for each in outcomes]}


def format_row(name: str, outcomes: Sequence[SessionStartResult]) -> str:
    """One row of the table."""
    known = [each for each in outcomes if each.frames is not None]
    counts = (len(outcomes), len(known), sum(each.is_wrong for each in known))
    return TABLE.row(
        name,
        *counts,
        known_median([each.frames for each in known]),
        known_median([each.error_m for each in known]),
        *(
            max((getattr(each, figure) for each in known), default=None)
            for figure in ("error_m", "error_deg", "settled_error_m", "settled_error_deg")
        ),
    )
