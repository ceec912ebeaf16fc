"""What kind of recording a path is, and its opening."""

from enum import StrEnum
from pathlib import Path

from drivers.core.errors import InputError
from drivers.recording.recording import ImageTopics, Recording
from drivers.tum.folder import open_tum_folder

BAG_SUFFIXES = (".mcap", ".bag", ".db3")


class RecordingFormat(StrEnum):
    """The kinds of recordings, as in camera sources."""

    TUM = "tum"  # a folder of images and lists
    BAG = "bag"  # MCAP, a ROS 2 bag or a ROS 1 bag


def recording_format(path: Path) -> RecordingFormat:
    """Tell the format of a recording, which need not exist, by its suffix and its files."""
    if path.suffix.lower() in BAG_SUFFIXES and not path.is_dir():
        return RecordingFormat.BAG
    if (path / "metadata.yaml").exists():
        return RecordingFormat.BAG
    names = {each.name for each in path.iterdir()} if path.is_dir() else set()
    # A ROS 2 bag that was cut off has no metadata; a TUM folder may have a bag beside its lists.
    is_tum = not names.isdisjoint(("rgb.txt", "associations.txt"))
    is_cut_off = any(name.endswith((".mcap", ".db3")) for name in names) and not is_tum
    return RecordingFormat.BAG if is_cut_off else RecordingFormat.TUM


def open_recording(
    path: Path, camera_file: Path | None = None, topics: ImageTopics | None = None
) -> Recording:
    """Open and check a recording, and load its first frame.

    Args:
        path: A folder in TUM format, an MCAP file, a ROS 2 bag (folder or .db3) or a ROS 1 bag.
        camera_file: Camera file; None for the recording's own.
        topics: The topics of the color and the depth images in a bag; None to find them.

    Raises:
        InputError: The recording cannot be used, or the packages for its format are missing.
    """
    if recording_format(path) is RecordingFormat.TUM:
        if topics is not None:
            raise InputError(f"{path}: is a folder, which has no topics; leave out --topics")
        return open_tum_folder(path, camera_file)
    check_bag_packages(path)
    from drivers.bag.bag import open_bag  # its packages are optional

    return open_bag(path, camera_file, topics)


def check_bag_packages(path: Path) -> None:
    """Raise InputError if the packages that a bag needs are not installed."""
    try:
        import mcap  # noqa: F401
        import rosbags  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path}: MCAP files and ROS bags need the package {error.name}; "
            "run: pip install 'kinect-vo[bags]'"
        ) from error
