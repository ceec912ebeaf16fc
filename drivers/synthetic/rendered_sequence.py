"""Rendered frames on disk: each is rendered once, by the first process that needs it.

KEY.frames holds the frames one after another. KEY.index holds a 64-bit number for each: 0 until the
frame is written, then its checksum with the highest bit set. A frame is therefore valid only when
it is complete, even if a process was killed. All processes render a frame to the same bytes.
"""

import hashlib
import mmap
import os
import zlib
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core import CameraError, InputError
from drivers.core.files import lock_folder
from drivers.core.input_files import read_input
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.sensors import RenderedImages

MAX_SEQUENCE_BYTES = 3 << 30
MAX_FOLDER_BYTES = 4 << 30
_WRITTEN = 1 << 63


@dataclass(frozen=True)
class SequenceFiles:
    """The files of a sequence of `count` frames of `height` x `width` pixels."""

    folder: Path
    key: str
    count: int
    height: int
    width: int

    @property
    def frames(self) -> Path:
        """The file of the frames."""
        return self.folder / f"{self.key}.frames"

    @property
    def index(self) -> Path:
        """The file of the checksums."""
        return self.folder / f"{self.key}.index"

    @property
    def frame_bytes(self) -> int:
        """Size of a frame: BGR color (3 bytes per pixel), then depth (2)."""
        return 5 * self.height * self.width

    @property
    def total_bytes(self) -> int:
        """Size of all frames."""
        return self.count * self.frame_bytes


def files_for_config(config: SyntheticConfig, folder: Path) -> SequenceFiles:
    """Return the files of a configuration; their key changes with all that may change a pixel.

    Raises:
        InputError: There are too many frames to store, or the track cannot be read.
    """
    camera = config.camera
    files = SequenceFiles(folder, _key(config), config.frame_count, camera.height, camera.width)
    if files.total_bytes > MAX_SEQUENCE_BYTES:
        raise InputError(
            f"synthetic camera: {files.count} frames need {files.total_bytes / 1e9:.1f} GB, the "
            f"limit is {MAX_SEQUENCE_BYTES / 1e9:.1f} GB: set a shorter duration_s; with loop = "
            "true it is played for ever"
        )
    return files


def _key(config: SyntheticConfig) -> str:
    """Digest of the configuration without faults, of the renderer's code and of its libraries."""
    digest = hashlib.sha256(repr(replace(config, faults=(), track=None)).encode())
    digest.update(f"{np.__version__} {cv2.__version__}".encode())
    here = Path(__file__).parent
    try:
        drivers = here.parent
        sources = [*here.rglob("*.py"), *drivers.glob("*.py"), *drivers.glob("core/*.py")]
        for source in sorted(sources):
            digest.update(source.read_bytes())
        if config.track is not None:
            digest.update(read_input(config.track))
    except OSError as error:
        raise InputError(f"{error.filename}: cannot read it: {error.strerror}") from error
    return digest.hexdigest()[:24]


class RenderedSequence:
    """The frames of a sequence. Any number of threads and processes may use the same files."""

    def __init__(self, files: SequenceFiles) -> None:
        """Open files that `create_sequence` created. Raises OSError."""
        self.files = files
        self._frames = os.open(files.frames, os.O_RDWR | os.O_CLOEXEC)
        index = os.open(files.index, os.O_RDWR | os.O_CLOEXEC)
        try:
            shared = mmap.mmap(index, 8 * files.count)
        finally:
            os.close(index)
        self._index: NDArray[np.uint64] = np.frombuffer(shared, np.uint64)
        self._is_verified = np.zeros(files.count, np.bool_)

    def close(self) -> None:
        """Release the files. Safe to call twice."""
        if self._frames >= 0:
            os.close(self._frames)
            self._frames = -1

    def is_rendered(self, index: int) -> bool:
        """Whether a frame is rendered."""
        return bool(self._index[index])

    def missing_frames(self) -> NDArray[np.intp]:
        """Indices of the frames that are not rendered, in ascending order."""
        return np.flatnonzero(self._index == 0)

    def read(self, index: int) -> RenderedImages | None:
        """Read a frame; None if it is not rendered. A damaged frame is marked as not rendered."""
        if not self.is_rendered(index):
            return None
        size = self.files.height, self.files.width
        images = RenderedImages(np.empty((*size, 3), np.uint8), np.empty(size, np.uint16))
        offset = index * self.files.frame_bytes
        length = os.preadv(self._frames, [images.color_bgr.data, images.depth_raw.data], offset)
        # A checksum takes a millisecond, so each frame is verified once.
        is_whole = length == self.files.frame_bytes and (
            self._is_verified[index] or _index_entry(images) == int(self._index[index])
        )
        if not is_whole:
            self._index[index] = 0
            return None
        self._is_verified[index] = True
        return images

    def write(self, index: int, images: RenderedImages) -> None:
        """Store a frame. Raises OSError."""
        parts = [np.ascontiguousarray(part).data for part in (images.color_bgr, images.depth_raw)]
        length = os.pwritev(self._frames, parts, index * self.files.frame_bytes)
        if length != self.files.frame_bytes:
            raise OSError(f"{self.files.frames}: only {length} bytes of a frame were written")
        self._index[index] = _index_entry(images)


def _index_entry(images: RenderedImages) -> int:
    """Index entry of a complete frame."""
    return _WRITTEN | zlib.crc32(images.depth_raw.tobytes(), zlib.crc32(images.color_bgr.tobytes()))


def create_sequence(files: SequenceFiles) -> RenderedSequence:
    """Open a sequence; if there is none, allocate its disk space with all frames missing.

    The least recently used sequences are deleted when the folder becomes too large.

    Raises:
        InputError: The folder cannot be written.
        CameraError: The disk is full.
    """
    try:
        files.folder.mkdir(parents=True, exist_ok=True)
        with lock_folder(files.folder, waits=True):
            _evict_old_sequences(files)
            _allocate(files.frames, files.total_bytes)
            _allocate(files.index, 8 * files.count)
            return RenderedSequence(files)
    except (PermissionError, NotADirectoryError, FileExistsError) as error:
        raise InputError(f"{files.folder}: cannot store frames there: {error.strerror}") from error
    except OSError as error:
        raise CameraError(
            f"{files.folder}: cannot store {files.total_bytes / 1e6:.0f} MB of frames: "
            f"{error.strerror}; free some space or set a shorter duration_s"
        ) from error


def _allocate(path: Path, size: int) -> None:
    """Create a file of `size` zero bytes, unless the file has that size already.

    A full disk under a memory map would kill the process, so the space is allocated now.
    """
    fd = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        if os.fstat(fd).st_size != size:
            os.ftruncate(fd, 0)
            os.posix_fallocate(fd, 0, size)
        os.utime(fd)  # the time of the last use
    except OSError:
        path.unlink()
        raise
    finally:
        os.close(fd)


def _evict_old_sequences(files: SequenceFiles) -> None:
    """Delete the least recently used sequences until this one fits.

    Another process may be reading one; open files stay readable after their deletion.
    """
    others: dict[str, dict[Path, os.stat_result]] = defaultdict(dict)
    for path in files.folder.iterdir():
        if path.stem != files.key and path.is_file():
            others[path.stem][path] = path.stat()
    sizes = {key: sum(stat.st_size for stat in stats.values()) for key, stats in others.items()}
    used_s = {key: max(stat.st_mtime for stat in stats.values()) for key, stats in others.items()}
    total = files.total_bytes + sum(sizes.values())
    for key in sorted(others, key=lambda key: used_s[key]):
        if total <= MAX_FOLDER_BYTES:
            return
        total -= sizes[key]
        for path in others[key]:
            path.unlink(missing_ok=True)


@dataclass(frozen=True)
class RenderJob:
    """What to render and where to store it; the first message to the renderer.

    Attributes:
        rate_hz: As for `RenderSchedule`.
        wake_fd: An eventfd that is written to after each frame.
    """

    config: SyntheticConfig
    files: SequenceFiles
    rate_hz: float
    threads: int
    wake_fd: int

    @property
    def fds(self) -> tuple[int, ...]:
        """The file descriptor of the eventfd."""
        return (self.wake_fd,)


@dataclass(frozen=True)
class ReaderPosition:
    """The reader needs this frame next."""

    index: int


@dataclass(frozen=True)
class RenderRequest:
    """The reader waits for this frame."""

    index: int


@dataclass(frozen=True)
class RenderingComplete:
    """No frame is missing."""
