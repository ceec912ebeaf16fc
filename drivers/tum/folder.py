"""Opening of a folder in the format of the TUM RGB-D benchmark."""

from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME, find_calibration
from drivers.camera import MAX_PAIR_SKEW_US
from drivers.core import InputError
from drivers.recording.depth_enlargement import check_first_frame
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.pairing import pair_images
from drivers.recording.recorded_frames import FramePair, RecordedFrames
from drivers.recording.recording import Recording
from drivers.tum.accelerometer import read_accelerometer
from drivers.tum.ground_truth import read_ground_truth
from drivers.tum.index_files import read_associations, read_image_list


def open_tum_folder(folder: Path, camera_file: Path | None) -> Recording:
    """Read a folder's lists, camera, ground truth and gravity, and load its first frame.

    Raises:
        InputError: The folder cannot be used.
    """
    _check_folder(folder)
    frames = read_frame_pairs(folder)
    camera = find_calibration(folder, camera_file)
    truth, note = read_ground_truth(folder, frames.stamps_s)
    file = camera_file or folder / CAMERA_FILE_NAME
    source = f"camera file {file}" if file.exists() else "the TUM benchmark's, by the folder's name"
    unpaired = f"{folder}: images without a partner: {frames.unpaired}" if frames.unpaired else ""
    recording = Recording(
        folder,
        frames,
        camera,
        truth,
        read_accelerometer(folder),
        summary="; ".join(part for part in (note, unpaired) if part),
        intrinsics_source=source,
        depth_unit_source=source,
    )
    return check_frames(recording)


def check_frames(recording: Recording) -> Recording:
    """Load the first frame, see `check_first_frame`, and check that most other files exist.

    Raises:
        InputError: They do not, or the first frame does not fit the camera.
    """
    pairs = recording.frames.pairs
    _check_files(pairs)
    try:
        return check_first_frame(recording)
    except UnreadableFrameError as error:
        raise InputError(f"{error} (the first frame, {pairs[0].color.location})") from error


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
    missing_of_frame = [
        next((image for image in (pair.color, pair.depth) if not image.file.exists()), None)
        for pair in pairs
    ]
    missing = [image for image in missing_of_frame if image is not None]
    if missing_of_frame[0] is not None or 2 * len(missing) > len(pairs):
        raise InputError(
            f"{missing[0].location}: names {missing[0].file}, which is missing "
            f"({len(missing)} of {len(pairs)} frames lack a file); restore it or remove the line"
        )
