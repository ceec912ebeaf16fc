"""Relocalization trials from frames of a tour: tracking, a cover, then another place."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.rendered_views import THREADS, ObservedView, make_tour_frame, max_overlap
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.synthetic import SyntheticConfig
from drivers.synthetic.frame_provider import render_all
from drivers.synthetic.sensors import ImageSource, RenderedImages
from vo_service.terminal import Terminal

# Frames before, during and after the cover.
FRAMES_BEFORE, FRAMES_COVERED, FRAMES_AFTER = 600, 90, 60
# Views are compared with this stride. A place is seen if all views of its first SEEN_FRAMES have at
# least MIN_SEEN_OVERLAP; it is unseen if all its views have at most MAX_UNSEEN_OVERLAP.
VIEW_STRIDE = 15
MIN_SEEN_OVERLAP, MAX_UNSEEN_OVERLAP = 0.5, 0.02
SEEN_FRAMES = 30


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


def open_cached_sequence(folder: Path, config: SyntheticConfig, terminal: Terminal) -> ImageSource:
    """Open the rendered frames of a tour in FOLDER/sequences; render missing ones.

    Args:
        folder: Folder of the benchmark.
        config: The tour.
        terminal: Shows the progress.
    """
    # Each has its own folder: a cache folder is too small for two of this length.
    name = f"{'twins' if config.twin_corners else 'tour'}-{config.seed}"
    progress = terminal.progress_callback(f"rendering room {config.seed}: frame")
    sequence = render_all(config, folder / "sequences" / name, progress, THREADS)

    def read_images(index: int) -> RenderedImages:
        images = sequence.read(index % config.frame_count)
        assert images is not None, "all frames are rendered"
        return images

    return read_images


def trial_frames(
    trial: RelocalizationTrial, config: SyntheticConfig, sequence: ImageSource
) -> Iterator[RgbdFrame]:
    """Yield the frames of a trial, with evenly spaced stamps.

    Args:
        trial: The trial.
        config: The tour.
        sequence: Its rendered frames.
    """
    for seq, source in enumerate(trial.source_frames):
        frame = make_tour_frame(config, seq, sequence(int(source)))
        if FRAMES_BEFORE <= seq < FRAMES_BEFORE + FRAMES_COVERED:
            dark = np.zeros_like(frame.color_bgr), np.zeros_like(frame.depth_raw)
            frame = replace(frame, color_bgr=dark[0], depth_raw=dark[1])
        yield frame


def sample_views(
    config: SyntheticConfig, sequence: ImageSource, T_room_camera: Array
) -> list[ObservedView]:
    """Sample a view at every VIEW_STRIDE-th frame.

    Args:
        config: The tour.
        sequence: Its rendered frames.
        T_room_camera: (N, 4, 4) true poses of the frames.
    """
    numbers = range(0, len(T_room_camera), VIEW_STRIDE)
    return [
        ObservedView.from_frame(make_tour_frame(config, n, sequence(n)), T_room_camera[n])
        for n in numbers
    ]


def choose_trials(
    views: Sequence[ObservedView], count: int, unseen: bool, rng: np.random.Generator
) -> list[RelocalizationTrial]:
    """Choose up to `count` trials with different first frames.

    Args:
        views: Views of the tour from `sample_views`.
        count: The number of trials.
        unseen: Whether the place of the return is unseen before the cover, or seen.
        rng: Generator of the choice.
    """
    fits = _is_return_unseen if unseen else _is_return_seen
    span, after = FRAMES_BEFORE // VIEW_STRIDE, FRAMES_AFTER // VIEW_STRIDE
    chosen: list[RelocalizationTrial] = []
    for first in rng.permutation(len(views) - span):
        before = views[first : first + span]
        later = np.arange(first + span + FRAMES_COVERED // VIEW_STRIDE, len(views) - after)
        # Later places are tried in random order.
        for back in rng.permutation(later):
            if fits(before, views[back : back + after + 1]):
                overlap = first + np.argmax([view.overlap_with(views[back]) for view in before])
                chosen.append(
                    RelocalizationTrial(
                        *(VIEW_STRIDE * int(view) for view in (first, back, overlap))
                    )
                )
                break
        if len(chosen) == count:
            break
    return chosen


def _is_return_seen(before: Sequence[ObservedView], after: Sequence[ObservedView]) -> bool:
    first_second = after[: SEEN_FRAMES // VIEW_STRIDE + 1]
    return all(max_overlap(view, before) >= MIN_SEEN_OVERLAP for view in first_second)


def _is_return_unseen(before: Sequence[ObservedView], after: Sequence[ObservedView]) -> bool:
    return all(max_overlap(view, before) <= MAX_UNSEEN_OVERLAP for view in after)
