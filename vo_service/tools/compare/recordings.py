"""Recordings of a comparison, and the selection of their frames."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, has_match, nearest_indices
from drivers.playback.frame_reader import log_implausible
from drivers.playback.recording_formats import open_recording
from drivers.recording.recording import ImageTopics, Recording
from vo_service.terminal import announce, announce_if_slow
from vo_service.tools.evaluation.gaps import Gap, find_gaps

T = TypeVar("T")


@dataclass(frozen=True)
class FrameSelection:
    """Every n-th of the frames (`step`), up to the first `max_frames`."""

    step: int = 1
    max_frames: int | None = None

    def select(self, frames: Sequence[T]) -> list[T]:
        """Return the selected frames."""
        return list(frames[: self.max_frames : self.step])

    def __str__(self) -> str:
        """Describe the step."""
        return "every frame" if self.step == 1 else f"1 frame in {self.step}"

    @property
    def suffix(self) -> str:
        """Suffix for the recording's name; "" for all frames."""
        first = "" if self.max_frames is None else f"-first-{self.max_frames}"
        return first + (f"-every-{self.step}" if self.step > 1 else "")


ALL_FRAMES = FrameSelection()


@dataclass(frozen=True)
class BenchmarkRecording:
    """A checked recording, or a selection of its frames.

    Attributes:
        name: Name of the recording and of its cache folder.
        camera_file: Camera file that it was opened with.
        contents: Contents, with the selected frames.
        topics: Topics of its images in a bag, if they were named.
    """

    name: str
    folder: Path
    camera_file: Path | None
    contents: Recording
    frame_selection: FrameSelection = ALL_FRAMES
    topics: ImageTopics | None = None

    def select(self, frame_selection: FrameSelection) -> "BenchmarkRecording":
        """Return the recording with a selection of its frames."""
        frames = self.contents.frames
        selected = replace(frames, pairs=frame_selection.select(frames.pairs))
        contents = replace(self.contents, frames=selected)
        return replace(
            self,
            name=f"{self.name}{frame_selection.suffix}",
            frame_selection=frame_selection,
            contents=contents,
        )

    @property
    def folder_name(self) -> str:
        """Name of its folder or file, which all selections have in common."""
        return self.folder.resolve().name

    @property
    def summary(self) -> str:
        """Name, step and number of frames, as a heading."""
        frames = f"{len(self.frame_stamps_s)} frames in {self.duration_s:.1f} s"
        return f"{self.folder_name}, {self.frame_selection}: {frames}"

    @cached_property
    def frame_stamps_s(self) -> Array:
        """(F,) stamps of the frames."""
        return np.array([pair.color.stamp_s for pair in self.contents.frames.pairs])

    @cached_property
    def gaps(self) -> list[Gap]:
        """Gaps between its frames."""
        return find_gaps(self.frame_stamps_s)

    @property
    def truth(self) -> Trajectory | None:
        """The ground truth; None if it has none."""
        return self.contents.ground_truth

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last."""
        return float(self.frame_stamps_s[-1] - self.frame_stamps_s[0])

    @property
    def path_m(self) -> float | None:
        """Length of the true trajectory, from frame to frame; None if not known."""
        if self.truth is None:
            return None
        matched_s = self.frame_stamps_s[has_match(self.frame_stamps_s, self.truth.stamps_s)]
        if len(matched_s) < 2:
            return None
        positions_m = self.truth.T_world_camera[
            nearest_indices(self.truth.stamps_s, matched_s), :3, 3
        ]
        return float(np.linalg.norm(np.diff(positions_m, axis=0), axis=1).sum())


def open_recordings(
    folders: Sequence[Path], camera_file: Path | None, topics: ImageTopics | None = None
) -> list[BenchmarkRecording]:
    """Check and open recordings as `open_recording` does, before long runs.

    Raises:
        InputError: A folder is not usable, or two folders have the same name.
    """
    names = [folder.resolve().name for folder in folders]
    for name, count in Counter(names).items():
        if count > 1:
            same_name = [str(folder) for folder in folders if folder.resolve().name == name]
            raise InputError(
                f"{' and '.join(same_name)}: results are stored by the folder's name, and these "
                "names are equal; rename one folder, or use separate runs with their own --output"
            )
    return [
        BenchmarkRecording(
            name, folder, camera_file, _open(folder, camera_file, topics), topics=topics
        )
        for name, folder in zip(names, folders, strict=True)
    ]


def _open(path: Path, camera_file: Path | None, topics: ImageTopics | None) -> Recording:
    """Open a recording, and log what was found in a bag, and what is implausible."""
    with announce_if_slow(f"reading {path}"):
        recording = open_recording(path, camera_file, topics)
    recording.require_rising_stamps("so methods cannot be compared on it; use `kinect-vo replay`")
    if recording.summary:
        announce(recording.summary)
    log_implausible(recording)
    return recording
