"""Lossless conversion of recordings between a folder, MCAP and bags."""

import heapq
import logging
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from decimal import Decimal
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.calibration import CameraCalibration
from drivers.core import InputError
from drivers.core.files import PARTIAL_SUFFIX, check_suffix, partial_folder
from drivers.core.geometry import T_BODY_CAMERA, Array
from drivers.core.write_errors import writing
from drivers.playback.frame_reader import FrameReader
from drivers.playback.recording_formats import check_bag_packages, read_recorded_odometry
from drivers.recording.frame_encoding import FrameStamps, calibration_of_frame
from drivers.recording.image_decoding import UnreadableFrameError
from drivers.recording.odometry import ODOMETRY_TOPIC
from drivers.recording.recorded_frames import FramePair
from drivers.recording.recording import BagTopicsInUse, Recording
from drivers.recording.recording_sink import RecordingSink, StoredFrame
from drivers.ros_messages.decoding import decode_odometry
from drivers.tum.writer import TumFolder

if TYPE_CHECKING:  # its packages are optional
    from drivers.bag.bag_writer import BagWriter
    from drivers.bag.frame_writer import FrameWriter

_log = logging.getLogger(__name__)


class OutputFormat(StrEnum):
    """The formats that can be written."""

    FOLDER = "folder"
    MCAP = "mcap"
    ROS1 = "ros1"
    ROS2 = "ros2"


SUFFIXES = {OutputFormat.MCAP: ".mcap", OutputFormat.ROS1: ".bag"}
# As of files (.mp4, .zip), and not as in folders' names that end in a time or a size (10.30, 1.5m).
_FILE_SUFFIX = re.compile(r"\.[a-z][a-z0-9]{0,4}")


def choose_format(path: Path, requested: str | None) -> OutputFormat:
    """Return the requested format, or that of the path's suffix; else a folder.

    Raises:
        InputError: The requested format has a suffix, and the path has another one; or none is
            requested, and the path has the suffix of some other file.
    """
    suffix = path.suffix.lower()
    by_suffix = next((kind for kind in SUFFIXES if SUFFIXES[kind] == suffix), OutputFormat.FOLDER)
    output_format = by_suffix if requested is None else OutputFormat(requested)
    if output_format in SUFFIXES:
        check_suffix(path, [SUFFIXES[output_format]])
    elif suffix in SUFFIXES.values() or (requested is None and _FILE_SUFFIX.fullmatch(suffix)):
        raise InputError(
            f"{path}: would be a folder, but {suffix} is the suffix of a file; name FILE.mcap, or "
            "a folder without suffix"
        )
    return output_format


def convert(
    recording: Recording, path: Path, output_format: OutputFormat, progress: Callable[[int], None]
) -> int:
    """Write a recording in another format; after a failure nothing is left of it.

    Args:
        progress: Called with the number of written frames; an exception ends the conversion.

    Returns:
        Number of written frames. Frames that cannot be read are left out and logged.

    Raises:
        InputError: The path exists, or the recording does not fit into the format.
        WriteError: Writing fails.
    """
    if output_format is OutputFormat.ROS2 and not {"%", "?", "#"}.isdisjoint(str(path)):
        # rosbags opens it as a URI.
        raise InputError(f"{path}: a ROS 2 bag cannot have %, ? or # in its path; rename it")
    part = path.with_name(path.name + PARTIAL_SUFFIX)
    if path.exists():
        raise InputError(f"{path}: exists already; name a new file or folder")
    if part.exists():
        raise InputError(
            f"{part}: a conversion runs or was killed; remove it, or name another file"
        )
    with closing(recording), writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial_folder(path) as folder:
            count = _write(recording, folder / path.name, output_format, progress)
            (folder / path.name).rename(path)
    return count


def _write(
    recording: Recording, path: Path, output_format: OutputFormat, progress: Callable[[int], None]
) -> int:
    """Write the output, and return the number of its frames."""
    calibration, frames = _read_frames(recording)
    count = 0
    with _open_output(path, output_format, recording, calibration) as (sink, others):
        for frame in _write_others_before(others, frames):
            try:
                sink.write_frame(frame)
            except UnreadableFrameError as error:
                _log.warning("the frame at %s is left out: %s", frame.stamps.color, error)
                continue
            count += 1
            progress(count)
    return count


def _read_frames(recording: Recording) -> tuple[CameraCalibration, Iterator[StoredFrame]]:
    """Return the camera and the frames, with depth as each frame has it."""
    if recording.depth_camera is None and recording.depth_enlargement == 1:
        return recording.calibration, _stored_frames(recording)
    first = FrameReader(recording).read(recording.frames.pairs[0], 0)
    return calibration_of_frame(first), _registered_frames(recording)


def _stored_frames(recording: Recording) -> Iterator[StoredFrame]:
    for pair in recording.frames.pairs:
        stamps = FrameStamps(pair.color.stamp, pair.depth.stamp)
        try:
            color, depth = pair.color.read_stored_color(), pair.depth.read_stored_depth()
        except UnreadableFrameError as error:
            _log.warning("the frame at %s is left out: %s", stamps.color, error)
            continue
        yield StoredFrame(stamps, color, depth, _log_stamps(pair))


def _registered_frames(recording: Recording) -> Iterator[StoredFrame]:
    reader = FrameReader(recording)
    for seq, pair in enumerate(recording.frames.pairs):
        try:
            frame = reader.read(pair, seq)
        except UnreadableFrameError as error:
            _log.warning("the frame at %s is left out: %s", pair.color.stamp, error)
            continue
        stamps = FrameStamps.from_frame(frame)
        yield StoredFrame(stamps, frame.color_bgr, frame.depth_raw, _log_stamps(pair))


def _log_stamps(pair: FramePair) -> FrameStamps:
    return FrameStamps(pair.color.log_stamp, pair.depth.log_stamp)


# When it was recorded, s, and a function that writes it.
_Event = tuple[Decimal, Callable[[], None]]


def _write_others_before(
    others: Iterator[_Event], frames: Iterator[StoredFrame]
) -> Iterator[StoredFrame]:
    """Yield the frames; before each, write what was recorded before it."""
    other = next(others, None)
    for frame in frames:
        while other is not None and other[0] <= frame.log_times.color:
            other[1]()
            other = next(others, None)
        yield frame
    while other is not None:
        other[1]()
        other = next(others, None)


def _series(recording: Recording, sink: RecordingSink) -> Iterator[_Event]:
    """Yield the readings, gravity, true poses and odometry."""
    readings, gravity, truth = recording.accelerometer, recording.gravity, recording.ground_truth
    vectors = map(tuple, readings.acceleration_m_s2.tolist())
    events = [_events(readings.stamps_s, vectors, sink.write_reading)]
    if gravity is not None:
        vectors = map(tuple, (-gravity.acceleration_m_s2).tolist())
        events.append(_events(gravity.stamps_s, vectors, sink.write_gravity))
    if truth is not None:
        events.append(_events(truth.stamps_s, truth.T_world_camera, sink.write_true_pose))
    return heapq.merge(*events, _odometry(recording, sink), key=lambda event: event[0])


def _events(
    stamps_s: Array, values: Iterable[Any], write: Callable[[Decimal, Any], None]
) -> Iterator[_Event]:
    for stamp_s, value in zip(stamps_s, values, strict=True):
        stamp = Decimal(repr(float(stamp_s)))
        yield stamp, partial(write, stamp, value)


def _odometry(recording: Recording, sink: RecordingSink) -> Iterator[_Event]:
    for message in read_recorded_odometry(recording.path, (ODOMETRY_TOPIC,)):
        try:
            stamp = Decimal(repr(float(decode_odometry(message).stamp_s)))
        except ValueError as error:
            _log.warning(
                "%s: a message of %s is left out: %s", recording.path, ODOMETRY_TOPIC, error
            )
            continue
        yield stamp, partial(sink.write_odometry, stamp, message)


@contextmanager
def _open_output(
    path: Path, output_format: OutputFormat, recording: Recording, calibration: CameraCalibration
) -> Iterator[tuple[RecordingSink, Iterator[_Event]]]:
    """Open the output; yield what takes the frames, and what else is to be written."""
    if output_format is OutputFormat.FOLDER:
        recording.require_rising_stamps(
            "and a folder holds rising stamps only; convert to .mcap, .bag or --format ros2"
        )
        folder = TumFolder(path, recording.ground_truth, has_gravity=recording.gravity is not None)
        with closing(folder):
            sink = folder.begin(calibration, recording.frames.pairs[0].color.stamp)
            yield sink, _series(recording, sink)
        _name_left_out(recording)
        return
    check_bag_packages(path)
    from drivers.bag.bag_writer import create_bag

    with create_bag(path, output_format) as bag:
        if recording.topics is None:
            frames = _open_frame_writer(bag, recording, calibration)
            yield frames, _series(recording, frames)
        else:
            with _copied_messages(recording, recording.topics, bag) as messages:
                yield _open_frame_writer(bag, recording, calibration), messages


def _open_frame_writer(
    bag: "BagWriter", recording: Recording, calibration: CameraCalibration
) -> "FrameWriter":
    from drivers.bag.frame_writer import FrameWriter

    logged = _log_stamps(recording.frames.pairs[0])
    start = min(logged.color, logged.depth)
    if recording.topics is None:
        return FrameWriter(bag, calibration, start, T_base_camera=T_BODY_CAMERA)
    return FrameWriter(bag, calibration, start, recording.topics.camera_frame)


@contextmanager
def _copied_messages(
    recording: Recording, in_use: BagTopicsInUse, bag: "BagWriter"
) -> Iterator[Iterator[_Event]]:
    """Yield the messages of a bag that are not of its frames; then name those without a place."""
    from drivers.bag.bag_file import open_bag_file
    from drivers.bag.bag_storage import BagStorage
    from drivers.bag.frame_writer import FRAME_TOPICS
    from drivers.bag.message_copy import MessageCopier

    storage = BagStorage(recording.path)
    with open_bag_file(storage) as source:
        copier = MessageCopier(source, bag)
        others = set(source.types) - in_use.frames
        copies = copier.copies(sorted(others - FRAME_TOPICS))
        yield ((Decimal(log_ns).scaleb(-9), copy) for log_ns, copy in copies)
        left_out = copier.left_out | (others & FRAME_TOPICS)
        _log_left_out(recording.path, left_out, "the output has no place for them")


def _name_left_out(recording: Recording) -> None:
    """Name the topics of a bag that are not in a folder."""
    if recording.topics is None:
        return
    from drivers.bag.bag_file import open_bag_file
    from drivers.bag.bag_storage import BagStorage

    storage = BagStorage(recording.path)
    with open_bag_file(storage) as source:
        topics = recording.topics
        others = set(source.types) - topics.frames - topics.series - {ODOMETRY_TOPIC}
    _log_left_out(recording.path, others, "a folder has no place for them")


def _log_left_out(path: Path, topics: set[str], reason: str) -> None:
    if topics:
        _log.warning("%s: left out, because %s: %s", path, reason, ", ".join(sorted(topics)))
