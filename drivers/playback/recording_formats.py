"""The formats of recordings, and how a recording is opened."""

import logging
from collections.abc import Collection, Iterator
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

from drivers.core import InputError
from drivers.layouts import open_folder
from drivers.plausibility import find_stamp_fault
from drivers.recording.bag_names import is_bag_file
from drivers.recording.recording import ImageTopics, Recording
from drivers.tum.odometry import read_odometry

_log = logging.getLogger(__name__)


class RecordingFormat(StrEnum):
    """The kinds of recordings, as in camera sources."""

    TUM = "tum"  # a folder of images, in TUM format or another benchmark's layout
    BAG = "bag"  # MCAP, a ROS 2 bag or a ROS 1 bag


def recording_format(path: Path) -> RecordingFormat:
    """Tell the format of a recording, which need not exist, by its suffix and its files."""
    if not path.is_dir():
        return RecordingFormat.BAG if is_bag_file(path.name) else RecordingFormat.TUM
    if (path / "metadata.yaml").exists():
        return RecordingFormat.BAG
    names = set[str]()
    with suppress(PermissionError):  # which opening reports
        names = {each.name for each in path.iterdir()}
    # A ROS 2 bag that was cut off has no metadata; a TUM folder may have a bag beside its lists.
    is_tum = not names.isdisjoint(("rgb.txt", "associations.txt"))
    return (
        RecordingFormat.BAG if any(map(is_bag_file, names)) and not is_tum else RecordingFormat.TUM
    )


def open_recording(
    path: Path, camera_file: Path | None = None, topics: ImageTopics | None = None
) -> Recording:
    """Open and check a recording, load its first frame, and log what is wrong with its clock.

    Args:
        path: A folder in TUM format or another benchmark's layout, an MCAP file, a bag of ROS 1 or
            ROS 2, the folder of a bag, or the files of a split bag joined by commas.
        camera_file: Camera file; None for the recording's own.
        topics: The topics of the color and the depth images in a bag; None to find them.

    Raises:
        InputError: The recording cannot be used, or the packages for its format are missing.
    """
    if recording_format(path) is RecordingFormat.TUM:
        if topics is not None:
            raise InputError(f"{path}: is a folder, which has no topics; leave out --topics")
        recording = open_folder(path, camera_file)
    else:
        check_bag_packages(path)
        from drivers.bag.bag_reader import open_bag  # its packages are optional

        recording = open_bag(path, camera_file, topics)
    if recording.warning:
        _log.warning("%s", recording.warning)
    if fault := find_stamp_fault(recording.frames.stamps_s):
        _log.warning("%s: %s", path, fault)
    return recording


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


def read_recorded_odometry(path: Path, topics: Collection[str]) -> Iterator[bytes]:
    """Yield the messages of a base's odometry, CDR ``nav_msgs/msg/Odometry``, as recorded.

    Args:
        path: A recording, see `open_recording`.
        topics: Topics of a bag; a folder has one file.

    Raises:
        InputError: The recording is damaged; while iterating.
    """
    if recording_format(path) is RecordingFormat.TUM:
        return read_odometry(path)
    check_bag_packages(path)
    from drivers.bag.odometry_messages import read_odometry_messages

    return read_odometry_messages(path, topics)
