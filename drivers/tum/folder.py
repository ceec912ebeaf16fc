"""A recording in the layout of the TUM RGB-D benchmark: its check, and its images."""

from pathlib import Path

from drivers.calibration import find_calibration
from drivers.core.errors import InputError
from drivers.core.trajectory import read_trajectory
from drivers.recording.images import UnreadableFrameError
from drivers.recording.recording import (
    FramePair,
    RecordedFrames,
    RecordedImage,
    Recording,
    pair_images,
)
from drivers.time_sync import MAX_PAIR_SKEW_US
from drivers.tum.index_files import read_associations, read_gravity, read_image_list


def open_tum_folder(folder: Path, camera_file: Path | None) -> Recording:
    """Read a folder's lists, camera, ground truth and gravity, and load its first frame.

    Raises:
        InputError: The folder cannot be used.
    """
    _check_folder(folder)
    frames = read_frame_pairs(folder)
    camera = find_calibration(folder, camera_file)
    _check_files(frames.pairs)
    try:
        size = (camera.width, camera.height)
        frames.pairs[0].load(size, size)
    except UnreadableFrameError as error:
        location = frames.pairs[0].color.location
        raise InputError(f"{error} (the first frame, {location})") from error
    truth_file = folder / "groundtruth.txt"
    ground_truth = read_trajectory(truth_file) if truth_file.exists() else None
    return Recording(folder, frames, camera, ground_truth, read_gravity(folder))


def _check_folder(folder: Path) -> None:
    if not folder.exists():
        raise InputError(f"{folder}: no such folder; check the path")
    if not folder.is_dir():
        raise InputError(
            f"{folder}: is not a folder, nor a .mcap, .bag or .db3 file; unpack an archive and "
            "name its folder"
        )
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from error
    if empty:
        raise InputError(f"{folder}: the folder is empty; name one with rgb.txt and depth.txt")


def read_frame_pairs(folder: Path) -> RecordedFrames:
    """Read the frames in a folder's lists, without its images and its camera.

    Raises:
        InputError: A list is missing or does not parse, or no two images can be paired.
    """
    associations = folder / "associations.txt"
    if associations.exists():
        return RecordedFrames(read_associations(associations))
    for name in ("rgb.txt", "depth.txt"):
        if not (folder / name).exists():
            raise InputError(
                f"{folder / name}: no such file; a TUM folder holds rgb.txt and depth.txt, "
                "or associations.txt"
            )
    color, depth = read_image_list(folder / "rgb.txt"), read_image_list(folder / "depth.txt")
    frames = pair_images(color, depth)
    if not frames.pairs:
        raise InputError(
            f"{folder}: no color and depth images within {MAX_PAIR_SKEW_US // 1000} ms of each "
            "other; rgb.txt and depth.txt must be of one recording, with stamps in seconds"
        )
    return frames


def _check_files(pairs: list[FramePair]) -> None:
    """Raise InputError unless the files of the first frame and of most others exist."""
    missing_of_frame = [_missing_file(pair) for pair in pairs]
    missing = [image for image in missing_of_frame if image is not None]
    if missing_of_frame[0] is not None or 2 * len(missing) > len(pairs):
        raise InputError(
            f"{missing[0].location}: names {missing[0].file}, which is missing "
            f"({len(missing)} of {len(pairs)} frames lack a file); restore it or remove the line"
        )


def _missing_file(pair: FramePair) -> RecordedImage | None:
    return next((image for image in (pair.color, pair.depth) if not image.file.is_file()), None)
