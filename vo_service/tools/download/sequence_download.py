"""Download of one sequence: fetch, check, unpack beside the target, then rename in one step."""

import gzip
import hashlib
import shutil
import tarfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO

from drivers.core import InputError, UserFacingError
from drivers.core.write_errors import create_output_folder
from drivers.tum.folder import open_tum_folder
from vo_service.terminal import Terminal
from vo_service.tools.download.catalog import BenchmarkSequence
from vo_service.tools.download.transfer import (
    PartialFile,
    TransferProgress,
    disk_error,
    fetch_with_retries,
)

CHUNK_BYTES = 1 << 16
# Images hardly compress; these limits stop archives that are made to fill the disk.
MAX_MEMBERS = 50_000
MAX_EXPANSION_RATIO = 5
MIN_SIZE_LIMIT_BYTES = 64 << 20
MAX_NAME_BYTES = 255
# Errors of tarfile, gzip and zlib for incomplete or invalid data.
DAMAGE_ERRORS = (
    EOFError, zlib.error, tarfile.TarError, gzip.BadGzipFile,
    ValueError, LookupError, ArithmeticError, RecursionError,
)  # fmt: skip


class DamagedArchiveError(UserFacingError):
    """The archive is incomplete or not an archive. Another download may be good."""


class UnsafeArchiveError(UserFacingError):
    """The archive has unsafe contents. Another download will have them, too."""


class _CheckedHeader(tarfile.TarInfo):
    """Header of a member. Any kind of header with a negative size is rejected when it is read.

    Some versions of tarfile seek back by such a size in an endless loop.
    """

    @property
    def size(self) -> int:
        """Size of the member, bytes."""
        return self._size

    @size.setter
    def size(self, size: int) -> None:
        if size < 0:
            raise UnsafeArchiveError(f"{self.name!r}, of {size} bytes")
        self._size = size


class _BoundedGzip(gzip.GzipFile):
    """Decompressed stream of limited size.

    Attributes:
        last_read: The data of the last read; zeros mark the end of an archive.
    """

    def __init__(self, file: IO[bytes], max_bytes: int) -> None:
        super().__init__(fileobj=file, mode="rb")
        self._max_bytes = max_bytes
        self.last_read = b""

    def read(self, size: int | None = -1) -> bytes:
        """Read at most `CHUNK_BYTES`, because tarfile keeps each piece in memory."""
        if size is None or not 0 <= size <= CHUNK_BYTES:
            raise UnsafeArchiveError(f"a header of {size} bytes")
        self.last_read = super().read(size)
        if self.tell() > self._max_bytes:
            raise UnsafeArchiveError(f"more than {self._max_bytes / 1e6:.0f} MB once unpacked")
        return self.last_read


def unpack(archive: Path, folder: Path, on_progress: TransferProgress) -> None:
    """Unpack a .tgz into a new `folder`. After an error, unpacked files are left there.

    Raises:
        DamagedArchiveError: The archive is incomplete or invalid.
        UnsafeArchiveError: The archive has unsafe contents.
        UserFacingError: The disk is full or not writable.
    """
    size = archive.stat().st_size
    try:
        folder.mkdir()
        with archive.open("rb") as file:
            stream = _BoundedGzip(file, max(MIN_SIZE_LIMIT_BYTES, MAX_EXPANSION_RATIO * size))
            _unpack_all(stream, folder, lambda: on_progress(file.tell(), size))
    except DAMAGE_ERRORS as error:
        raise DamagedArchiveError(str(error) or type(error).__name__) from error
    except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
        raise UnsafeArchiveError(f"{Path(error.filename).name!r} twice") from error
    except OSError as error:
        raise disk_error(folder.parent, error) from error


def _unpack_all(stream: _BoundedGzip, folder: Path, on_chunk: Callable[[], None]) -> None:
    with tarfile.open(fileobj=stream, mode="r:", tarinfo=_CheckedHeader) as tar:
        for count, member in enumerate(tar):
            if count == MAX_MEMBERS:
                raise UnsafeArchiveError(f"more than {MAX_MEMBERS} files")
            _unpack_one(tar, member, folder, on_chunk)
    # An invalid header ends tarfile's loop like the end of the archive. Zeros mark the true end;
    # reading to the end of the stream verifies its checksum.
    while not any(stream.last_read):
        if not stream.read(CHUNK_BYTES):
            return
    raise DamagedArchiveError("a header cannot be read")


def _unpack_one(
    tar: tarfile.TarFile, member: tarfile.TarInfo, folder: Path, on_chunk: Callable[[], None]
) -> None:
    path = folder / safe_path(member.name)
    if member.type == tarfile.DIRTYPE:
        path.mkdir(parents=True, exist_ok=True)
        return
    if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or member.issparse():
        raise UnsafeArchiveError(f"{member.name!r}, which is neither a file nor a folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    source = tar.extractfile(member)
    assert source is not None  # a regular file, as checked above
    with source, path.open("xb") as target:
        while data := source.read(CHUNK_BYTES):
            target.write(data)
            on_chunk()


def safe_path(name: str) -> PurePosixPath:
    """Return a member's path below the folder.

    Raises:
        UnsafeArchiveError: If it lies outside.
    """
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise UnsafeArchiveError(f"{name!r}, which lies outside its folder")
    if any(len(part.encode(errors="surrogateescape")) > MAX_NAME_BYTES for part in path.parts):
        raise UnsafeArchiveError(f"{name[:40]!r}..., whose name is too long")
    return path


def download_sequence(
    sequence: BenchmarkSequence, folder: Path, source: str, sha256: str | None, terminal: Terminal
) -> None:
    """Download a sequence into a folder, which appears only when it is complete.

    An existing folder is not changed. A partial download is kept for the next time, unless the
    archive is unusable.

    Args:
        source: Address of the benchmark's host or of a mirror.
        sha256: Required digest of the archive, hexadecimal; None for any.

    Raises:
        UserFacingError: The download fails.
    """
    create_output_folder(folder.parent)
    with PartialFile(folder.with_name(f".{folder.name}.tgz.part")) as part:
        if not folder.exists():
            url = sequence.url(source)
            fetch_with_retries(url, part, partial(terminal.progress_bytes, sequence.name))
            try:
                if sha256:
                    _check_digest(part.path, sha256)
                _unpack_into(
                    folder,
                    part.path,
                    partial(terminal.progress_bytes, f"{sequence.name}: unpacking"),
                )
            except (DamagedArchiveError, UnsafeArchiveError) as error:
                part.discard()
                raise _unusable_archive_error(url, error) from error
        part.discard()


def _check_digest(archive: Path, sha256: str) -> None:
    with archive.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != sha256.lower():
        raise DamagedArchiveError(f"its SHA-256 is {digest}")


def _unpack_into(folder: Path, archive: Path, on_progress: TransferProgress) -> None:
    """Unpack into a temporary folder, check that it can be replayed, then rename it to `folder`."""
    temporary = folder.with_name(f".{folder.name}.unpacking")
    shutil.rmtree(temporary, ignore_errors=True)  # left by a killed process
    try:
        unpack(archive, temporary, on_progress)
        # The camera follows from the folder's name, so the archive's own name is replaced.
        recording = _find_recording(temporary).rename(temporary / folder.name)
        _check_recording(recording)
        recording.rename(folder)
    except OSError as error:
        raise disk_error(folder.parent, error) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _find_recording(folder: Path) -> Path:
    """Return the unpacked recording. Raises UnsafeArchiveError unless there is exactly one."""
    recordings = [index_file.parent for index_file in sorted(folder.glob("*/rgb.txt"))]
    if len(recordings) != 1:
        raise UnsafeArchiveError(f"{len(recordings) or 'no'} recordings in TUM format")
    return recordings[0]


def _check_recording(recording: Path) -> None:
    try:
        open_tum_folder(recording, None)
    except InputError as error:
        message = str(error).replace(str(recording), recording.name)
        raise UnsafeArchiveError(f"no recording that can be replayed ({message})") from error


def _unusable_archive_error(url: str, error: UserFacingError) -> UserFacingError:
    if isinstance(error, DamagedArchiveError):
        return UserFacingError(
            f"{url}: the archive is damaged ({error}) and has been removed; run the same command "
            "again, or use another source with --mirror"
        )
    return UserFacingError(
        f"{url}: the archive is unsafe and has been removed: it contains {error}; use another "
        "source with --mirror"
    )
