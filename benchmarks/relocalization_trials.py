"""Tries for relocalisation, cut out of the film of a tour: a way, a cover, another place."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.tour_frames import make_tour_frame
from benchmarks.view_overlap import ObservedView, max_overlap
from benchmarks.virtual_frames import THREADS
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.fault_injection import ImageSource, RenderedImages
from drivers.synthetic.frame_provider import render_all
from vo_service.terminal import Terminal

# Frames before the cover, covered, and after it.
FRAMES_BEFORE, FRAMES_COVERED, FRAMES_AFTER = 600, 90, 60
# Views are compared every so many frames. A place was seen before if so much of what it shows was,
# and it was not if hardly anything was, in every view of so many frames from the first on.
VIEW_STRIDE = 15
MIN_SEEN_OVERLAP, MAX_UNSEEN_OVERLAP = 0.5, 0.02
SEEN_FRAMES = 30


@dataclass(frozen=True)
class RelocalizationTrial:
    """Film frames `first` to `first` + BEFORE, then the camera is covered, then from `back` on.

    `alike` is the frame before the cover that shows most of what is seen at `back`.
    """

    first: int
    return_frame: int
    overlap_frame: int

    @property
    def source_frames(self) -> NDArray[np.int64]:
        """(F,) the frame of the film at each of the try; while covered, that before."""
        before = np.arange(self.first, self.first + FRAMES_BEFORE)
        covered = np.full(FRAMES_COVERED, before[-1])
        return np.concatenate(
            [before, covered, np.arange(self.return_frame, self.return_frame + FRAMES_AFTER)]
        )


def open_cached_sequence(folder: Path, config: SyntheticConfig, terminal: Terminal) -> ImageSource:
    """The film of a tour in FOLDER/films, rendered where there is none yet."""
    # A folder of its own for each: a film cache holds no more than one of this length.
    name = f"{'twins' if config.twin_corners else 'tour'}-{config.seed}"
    progress = terminal.progress_callback(f"rendering room {config.seed}: frame")
    sequence = render_all(config, folder / "films" / name, progress, THREADS)

    def images(index: int) -> RenderedImages:
        found = sequence.read(index % config.frame_count)
        assert found is not None, "it was rendered"
        return found

    return images


def trial_frames(
    trial: RelocalizationTrial, config: SyntheticConfig, sequence: ImageSource
) -> Iterator[RgbdFrame]:
    """The frames of a try, with stamps that go on evenly."""
    for seq, shown in enumerate(trial.source_frames):
        frame = make_tour_frame(config, seq, sequence(int(shown)))
        if FRAMES_BEFORE <= seq < FRAMES_BEFORE + FRAMES_COVERED:
            dark = np.zeros_like(frame.color_bgr), np.zeros_like(frame.depth_raw)
            frame = replace(frame, color_bgr=dark[0], depth_raw=dark[1])
        yield frame


def sample_views(
    config: SyntheticConfig, sequence: ImageSource, T_room_camera: Array
) -> list[ObservedView]:
    """What every EVERY-th frame of the film shows."""
    numbers = range(0, len(T_room_camera), VIEW_STRIDE)
    return [
        ObservedView.from_frame(make_tour_frame(config, n, sequence(n)), T_room_camera[n])
        for n in numbers
    ]


def choose_trials(
    views: Sequence[ObservedView], count: int, unseen: bool, rng: np.random.Generator
) -> list[RelocalizationTrial]:
    """Up to `count` tries that come back where it was seen before, or where it was not.

    Fewer where the film has not so many: none of its ways is taken twice.
    """
    fits = _is_return_unseen if unseen else _is_return_seen
    span, after = FRAMES_BEFORE // VIEW_STRIDE, FRAMES_AFTER // VIEW_STRIDE
    chosen: list[RelocalizationTrial] = []
    for first in rng.permutation(len(views) - span):
        before = views[first : first + span]
        later = np.arange(first + span + FRAMES_COVERED // VIEW_STRIDE, len(views) - after)
        # The later places in any order; the first that fits is taken.
        for back in rng.permutation(later):
            if fits(before, views[back : back + after + 1]):
                alike = first + np.argmax([view.overlap_with(views[back]) for view in before])
                chosen.append(
                    RelocalizationTrial(*(VIEW_STRIDE * int(view) for view in (first, back, alike)))
                )
                break
        if len(chosen) == count:
            break
    return chosen


TrialFilter = Callable[[Sequence[ObservedView], Sequence[ObservedView]], bool]


def _is_return_seen(before: Sequence[ObservedView], after: Sequence[ObservedView]) -> bool:
    first_second = after[: SEEN_FRAMES // VIEW_STRIDE + 1]
    return all(max_overlap(view, before) >= MIN_SEEN_OVERLAP for view in first_second)


def _is_return_unseen(before: Sequence[ObservedView], after: Sequence[ObservedView]) -> bool:
    return all(max_overlap(view, before) <= MAX_UNSEEN_OVERLAP for view in after)
