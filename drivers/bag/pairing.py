"""Frames of a bag from its images, whose clock may jump."""

from bisect import bisect
from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

from drivers.bag.image_messages import ImageMessage
from drivers.clock_jumps import split_at_jumps
from drivers.recording.frame_encoding import FrameStamps, format_stamp
from drivers.recording.pairing import pair_images, stamps_us
from drivers.recording.recorded_frames import FramePair, RecordedFrames


@dataclass(frozen=True)
class FoundFrames:
    """The frames of a bag.

    Attributes:
        frames: All frames, in the order of recording.
        left_out: The number of images with wrong stamps.
        jumps: Last stamp before and first stamp after each jump of the clock back, s.
    """

    frames: RecordedFrames
    left_out: int
    jumps: Sequence[tuple[Decimal, Decimal]]

    def warning(self, path: Path) -> str:
        """Say what the clock did; "" if it was steady."""
        parts = []
        if self.left_out:
            parts.append(f"{self.left_out} images are left out, because their stamps are wrong")
        if self.jumps:
            (before, after), *others = self.jumps
            where = format_stamp(before) + (f" and {len(others)} times more" if others else "")
            parts.append(
                f"the clock jumps back by {before - after:.1f} s after {where}; a new epoch of the "
                "odometry starts there"
            )
        return f"{path}: {', and '.join(parts)}" if parts else ""


def match_recorded_frames(
    stamps: Sequence[FrameStamps], colors: Sequence[ImageMessage], depths: Sequence[ImageMessage]
) -> FoundFrames:
    """Match the images of a recording of this program, which has the stamps of each frame.

    Args:
        stamps: The stamps of each frame, s, in the order of recording.
        colors: The color images, in the order of recording.
        depths: The depth images, in the order of recording.
    """
    color_of, depth_of = _by_stamp(colors), _by_stamp(depths)
    pairs = [
        FramePair(color_of[each.color].popleft(), depth_of[each.depth].popleft())
        for each in stamps
        if color_of[each.color] and depth_of[each.depth]
    ]
    runs = split_at_jumps(stamps_us([pair.color for pair in pairs]).tolist())
    kept = [[pairs[k] for k in run] for run in runs]
    return _join(kept, unpaired=0, left_out=2 * (len(pairs) - sum(map(len, kept))))


def _by_stamp(images: Sequence[ImageMessage]) -> dict[Decimal, deque[ImageMessage]]:
    found: dict[Decimal, deque[ImageMessage]] = defaultdict(deque)
    for image in images:
        found[image.stamp].append(image)
    return found


def pair_between_jumps(
    colors: Sequence[ImageMessage], depths: Sequence[ImageMessage]
) -> FoundFrames:
    """Pair the images between jumps of the color images' clock, see `pair_images`.

    Args:
        colors: The color images, in the order of recording.
        depths: The depth images, in the order of recording.
    """
    color_runs = [[colors[k] for k in run] for run in split_at_jumps(stamps_us(colors).tolist())]
    limits_ns = [(a[-1].key.log_ns + b[0].key.log_ns) // 2 for a, b in pairwise(color_runs)]
    depth_runs: list[list[ImageMessage]] = [[] for _ in color_runs]
    for depth in depths:
        depth_runs[bisect(limits_ns, depth.key.log_ns)].append(depth)
    frames = []
    left_out = len(colors) + len(depths)
    for color_run, depth_run in zip(color_runs, depth_runs, strict=True):
        (rising,) = split_at_jumps(stamps_us(depth_run).tolist(), jump_cost=len(depth_run))
        frames.append(pair_images(color_run, [depth_run[k] for k in rising]))
        left_out -= len(color_run) + len(rising)
    return _join([each.pairs for each in frames], sum(each.unpaired for each in frames), left_out)


def _join(runs: Sequence[list[FramePair]], unpaired: int, left_out: int) -> FoundFrames:
    runs = [run for run in runs if run]
    jumps = [(a[-1].color.stamp, b[0].color.stamp) for a, b in pairwise(runs)]
    pairs = [pair for run in runs for pair in run]
    return FoundFrames(RecordedFrames(pairs, unpaired), left_out, jumps)
