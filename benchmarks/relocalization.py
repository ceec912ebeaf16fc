"""Relocalization of a camera that is covered and then uncovered at another place.

In each trial the camera follows a tour for 20 s, is covered for 3 s, and is uncovered at a place
that it saw before on another lap; with --unseen at a place that it did not see. View overlap is
computed from true poses and measured depth. Each seed is another room. Its frames of a minute
(2.8 GB) are stored in FOLDER/sequences and rendered the first time: two minutes on two idle
cores. A trial takes five seconds. The results of each seed are stored in FOLDER/results.json;
remove that file to measure again.

"old" counts the trials that relocalize in the map from before the cover, "in 1 s" those of them
within 30 frames, "new" those with a new map, "nowhere" those without a pose in 2 s. "wrong" has a
pose with an unreported error above 5 cm or 3 degrees: in the old map compared with the truth at
that place, in a new map with the motion since its first pose. "frames" is the median time until
the first pose. "median", "largest" (mm) and "deg" are its errors in the old map.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Json, ResultCache, Table, known_median, option
from benchmarks.rendered_sequences import THREADS
from benchmarks.tours import (
    LoopClosureRunner,
    compute_true_poses,
    make_tour_config,
    make_tour_frame,
)
from benchmarks.tracking import METHOD, is_gross, pose_error
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, inverse, transform_points
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.frame_provider import render_all
from drivers.synthetic.sensors import RenderedImages
from vo_service.odometry.warm_up import warm_up
from vo_service.terminal import Terminal
from vo_service.types.estimate import Estimate

# Two laps.
SEQUENCE_S = 60.0
# Frames before, during and after the cover.
FRAMES_BEFORE, FRAMES_COVERED, FRAMES_AFTER = 600, 90, 60
# Views are compared with this stride. A place is seen if all views of its first SEEN_FRAMES have at
# least MIN_SEEN_OVERLAP; it is unseen if all its views have at most MAX_UNSEEN_OVERLAP.
VIEW_STRIDE = 15
MIN_SEEN_OVERLAP, MAX_UNSEEN_OVERLAP = 0.5, 0.02
SEEN_FRAMES = 30
MAX_PROMPT_FRAMES = 30
# Stride of the grid of pixels that represents a view.
STEP_PX = 32
# A point is visible in another view if its depth there agrees within this distance.
MAX_SAME_DISTANCE_M = 0.10
TABLE = Table(
    *(28, "tries:9d", "old:9d", "in 1 s:9d", "new:9d", "nowhere:9d", "wrong:9d", "frames:9.1f"),
    *("median:9.1mm", "largest:9.1mm", "deg:9.1f"),
)


@dataclass(frozen=True)
class TourSequence:
    """A rendered tour: its frames, and its true poses T_room_camera (N, 4, 4)."""

    config: SyntheticConfig
    images: Callable[[int], RenderedImages]
    T_room_camera: Array

    @classmethod
    def open(cls, folder: Path, seed: int, terminal: Terminal) -> "TourSequence":
        """Open the tour of a seed in FOLDER/sequences; render missing frames."""
        config = make_tour_config(seed, SEQUENCE_S, aliased_corners=False)
        # Each has its own folder: a cache folder is too small for two of this length.
        progress = partial(terminal.progress, f"rendering room {seed}: frame")
        sequence = render_all(config, folder / "sequences" / f"tour-{seed}", progress, THREADS)

        def read_images(index: int) -> RenderedImages:
            images = sequence.read(index % config.frame_count)
            assert images is not None, "all frames are rendered"
            return images

        return cls(config, read_images, compute_true_poses(config))

    def frame(self, number: int, seq: int | None = None) -> RgbdFrame:
        """Read a frame; it gets the number and the stamp of `seq`, by default its own."""
        seq = number if seq is None else seq
        return make_tour_frame(self.config, seq, self.images(number))


@dataclass(frozen=True)
class ObservedView:
    """Points (N, 3) in the room at a grid of pixels, and the camera.

    `depth_m` is the whole image (H, W) as float16, 0 = no reading.
    """

    camera: PinholeCamera
    T_room_camera: Array
    points_m: Array
    depth_m: NDArray[np.float16]

    @classmethod
    def from_frame(cls, frame: RgbdFrame, T_room_camera: Array) -> "ObservedView":
        """Make the view of a frame with a known pose."""
        camera, half = frame.camera, STEP_PX // 2
        v, u = np.mgrid[half : camera.height : STEP_PX, half : camera.width : STEP_PX]
        z = frame.depth_m[v, u].astype(np.float64)
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(z)])
        points_m = (rays * z)[:, z > 0].T
        return cls(
            camera,
            T_room_camera,
            transform_points(T_room_camera, points_m),
            frame.depth_m.astype(np.float16),
        )

    def overlap_with(self, other: "ObservedView") -> float:
        """Fraction of the other view's points that are visible in this view."""
        if not len(other.points_m):
            return 0.0
        x, y, z = transform_points(inverse(self.T_room_camera), other.points_m).T
        ahead = np.maximum(z, 1e-6)
        u = np.rint(self.camera.fx * x / ahead + self.camera.cx).astype(int)
        v = np.rint(self.camera.fy * y / ahead + self.camera.cy).astype(int)
        height, width = self.depth_m.shape
        inside = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        there_m = self.depth_m[v[inside], u[inside]].astype(np.float64)
        is_same = (there_m > 0) & (np.abs(there_m - z[inside]) < MAX_SAME_DISTANCE_M)
        return float(np.count_nonzero(is_same)) / len(other.points_m)


def view_overlaps(views: Sequence[ObservedView]) -> Array:
    """The fraction (V, V) of the points of each view, by column, that each view shows, by row."""
    return np.array([[view.overlap_with(other) for other in views] for view in views])


@dataclass(frozen=True)
class RelocalizationTrial:
    """A trial on the frames of a tour.

    Attributes:
        first: First of the FRAMES_BEFORE frames before the cover.
        return_frame: First frame after the cover.
        overlap_frame: The frame before the cover that shows most of the view at `return_frame`.
    """

    first: int
    return_frame: int
    overlap_frame: int

    @property
    def source_frames(self) -> NDArray[np.int64]:
        """(F,) index in the tour of each frame; the last one before the cover while covered."""
        before = np.arange(self.first, self.first + FRAMES_BEFORE)
        covered = np.full(FRAMES_COVERED, before[-1])
        return np.concatenate(
            [before, covered, np.arange(self.return_frame, self.return_frame + FRAMES_AFTER)]
        )


def choose_trials(
    overlaps: Array, count: int, unseen: bool, rng: np.random.Generator
) -> list[RelocalizationTrial]:
    """Choose up to `count` trials with different first frames.

    Args:
        overlaps: Of all views of the tour, as of `view_overlaps`.
        unseen: Whether the place of the return is unseen before the cover, or seen.
    """
    span, covered, after = (
        frames // VIEW_STRIDE for frames in (FRAMES_BEFORE, FRAMES_COVERED, FRAMES_AFTER)
    )
    compared = (after if unseen else SEEN_FRAMES // VIEW_STRIDE) + 1
    chosen: list[RelocalizationTrial] = []
    for first in rng.permutation(len(overlaps) - span):
        before = overlaps[first : first + span]
        known = before.max(axis=0)
        fits = known <= MAX_UNSEEN_OVERLAP if unseen else known >= MIN_SEEN_OVERLAP
        # Later places are tried in random order.
        for back in rng.permutation(np.arange(first + span + covered, len(overlaps) - after)):
            if fits[back : back + compared].all():
                views = (first, back, first + before[:, back].argmax())
                chosen.append(RelocalizationTrial(*(VIEW_STRIDE * int(view) for view in views)))
                break
        if len(chosen) == count:
            break
    return chosen


def trial_frames(trial: RelocalizationTrial, tour: TourSequence) -> Iterator[RgbdFrame]:
    """Yield the frames of a trial, with evenly spaced stamps."""
    for seq, source in enumerate(trial.source_frames):
        frame = tour.frame(int(source), seq)
        if FRAMES_BEFORE <= seq < FRAMES_BEFORE + FRAMES_COVERED:
            dark = np.zeros_like(frame.color_bgr), np.zeros_like(frame.depth_raw)
            frame = replace(frame, color_bgr=dark[0], depth_raw=dark[1])
        yield frame


@dataclass(frozen=True)
class RelocalizationOutcome:
    """Result of one trial.

    Attributes:
        frames: Frames from the first uncovered one to the first with a pose, both counted; None
            if there was none.
        is_old_map: Whether that pose is in the map from before the cover.
        error_m: Position error of that pose in the old map; None in a new one.
        error_deg: Its rotation error.
        is_wrong: Whether a pose after the cover has an error above 5 cm or 3 degrees, in the old
            map or relative to the first pose of its new map.
    """

    frames: int | None
    is_old_map: bool
    error_m: float | None
    error_deg: float | None
    is_wrong: bool


def evaluate_trial(
    estimates: Sequence[Estimate], T_room_camera: Array, overlap_frame: int
) -> RelocalizationOutcome:
    """Evaluate the estimates of a trial.

    The old map is aligned with the room at `overlap_frame`, so that drift elsewhere is not an error
    of the relocalization. A new map is aligned at its first pose.

    Args:
        estimates: F estimates.
        T_room_camera: True poses (F, 4, 4).
        overlap_frame: The frame before the cover that shows most of the place of the return.
    """
    epochs = np.cumsum([estimate.is_reset for estimate in estimates])
    old, errors = epochs[FRAMES_BEFORE - 1], dict[int, tuple[float, float]]()
    aligned = overlap_frame if epochs[overlap_frame] == old else FRAMES_BEFORE - 1
    T_room_world = {old: T_room_camera[aligned] @ inverse(estimates[aligned].T_world_camera)}
    for number in range(FRAMES_BEFORE + FRAMES_COVERED, len(estimates)):
        if estimates[number].ok:
            T_world_camera, T_room = estimates[number].T_world_camera, T_room_camera[number]
            T = T_room_world.setdefault(epochs[number], T_room @ inverse(T_world_camera))
            errors[number] = pose_error(T_room, T @ T_world_camera)
    first = min(errors, default=None)
    is_old = first is not None and bool(epochs[first] == old)
    error_m, error_deg = errors[first] if first is not None and is_old else (None, None)
    return RelocalizationOutcome(
        frames=None if first is None else first - (FRAMES_BEFORE + FRAMES_COVERED) + 1,
        is_old_map=is_old,
        error_m=error_m,
        error_deg=error_deg,
        is_wrong=any(is_gross(*error) for error in errors.values()),
    )


def format_row(name: str, outcomes: Sequence[RelocalizationOutcome]) -> str:
    """Count the outcomes, and format the errors in the old map."""
    old = [outcome for outcome in outcomes if outcome.is_old_map]
    waited = [outcome.frames for outcome in old if outcome.frames is not None]
    errors_m = [outcome.error_m for outcome in old if outcome.error_m is not None]
    errors_deg = [outcome.error_deg for outcome in old if outcome.error_deg is not None]
    nowhere = sum(outcome.frames is None for outcome in outcomes)
    return TABLE.row(
        name,
        len(outcomes),
        len(old),
        sum(frames <= MAX_PROMPT_FRAMES for frames in waited),
        len(outcomes) - len(old) - nowhere,
        nowhere,
        sum(outcome.is_wrong for outcome in outcomes),
        *(known_median(waited), known_median(errors_m)),
        *(max(errors_m, default=None), max(errors_deg, default=None)),
    )


@option("folder", type=Path, help="folder of rendered frames and results")
@option("--tries", type=int, default=100, help="trials of all seeds together")
@option("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
@option("--unseen", action="store_true", help="uncover the camera at places that it did not see")
@METHOD
def main(args: argparse.Namespace) -> None:
    """Run the seeds without stored results; print all of them, then all together."""
    cache, together = ResultCache(args.folder), list[RelocalizationOutcome]()
    warm_up(args.method, lambda stage: None)
    print(TABLE.head)
    for index, seed in enumerate(args.seeds):
        count = args.tries // len(args.seeds) + (index < args.tries % len(args.seeds))
        name = f"tour-{seed}-{'unseen' if args.unseen else 'seen'}-{args.method}"
        result = cache.get_or_run(f"{name}-{count}", partial(_measure, args, seed, count))
        outcomes = [RelocalizationOutcome(**each) for each in result["outcomes"]]
        together += outcomes
        print(format_row(name, outcomes), flush=True)
    print(format_row("together", together))


def _measure(args: argparse.Namespace, seed: int, count: int) -> Json:
    """Run the trials of one seed."""
    terminal = Terminal()
    tour = TourSequence.open(args.folder, seed, terminal)
    views = [
        ObservedView.from_frame(tour.frame(number), tour.T_room_camera[number])
        for number in range(0, len(tour.T_room_camera), VIEW_STRIDE)
    ]
    rng = np.random.default_rng([seed, 12])
    trials = choose_trials(view_overlaps(views), count, args.unseen, rng)
    outcomes = []
    for number, trial in enumerate(trials, 1):
        terminal.progress(f"room {seed}: trial", number, len(trials))
        runner = LoopClosureRunner(args.method)
        estimates = [runner.process(frame).estimate for frame in trial_frames(trial, tour)]
        truth = tour.T_room_camera[trial.source_frames]
        outcomes.append(evaluate_trial(estimates, truth, trial.overlap_frame - trial.first))
    terminal.clear()
    return {"tries": list(map(asdict, trials)), "outcomes": list(map(asdict, outcomes))}
