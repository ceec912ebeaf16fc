"""Unpacking an archive from a stranger: all of it, nothing but files, and all in one folder.

Stricter than the data filter of Python's tarfile (which the oldest Python supported lacks): what
that one would set right or follow, such as links, is refused, for a recording has none.
"""

import gzip
import tarfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import IO

from drivers.core.errors import UserFacingError
from vo_service.tools.download.partial_file import disk_error

CHUNK_BYTES = 1 << 16
# Images hardly shrink; these bounds are for archives that are meant to fill the disk.
MAX_MEMBERS = 50_000
MAX_EXPANSION_RATIO = 5
MIN_SIZE_LIMIT_BYTES = 64 << 20
MAX_NAME_BYTES = 255
# What tarfile, gzip and zlib raise for what is not whole or makes no sense.
DAMAGE_ERRORS = (
    EOFError, zlib.error, tarfile.TarError, gzip.BadGzipFile,
    ValueError, LookupError, ArithmeticError, RecursionError,
)  # fmt: skip
UnpackProgress = Callable[[int, int | None], None]  # bytes of the archive read, bytes in all


class DamagedArchiveError(UserFacingError):
    """It is not whole, or no archive at all: another copy may be."""


class UnsafeArchiveError(UserFacingError):
    """It holds what a recording does not: another copy will, too."""


class _CheckedHeader(tarfile.TarInfo):
    """A member's header; a size below zero is refused as it is read, from any kind of header.

    Some versions of tarfile go back by such a size, for ever; others call the archive damaged.
    """

    @property
    def size(self) -> int:
        """Bytes of the member."""
        return self._size

    @size.setter
    def size(self, size: int) -> None:
        if size < 0:
            raise UnsafeArchiveError(f"{self.name!r}, of {size} bytes")
        self._size = size


class _BoundedGzip(gzip.GzipFile):
    """A stream with an end. `last` is what was read last: zeros mark the end of an archive."""

    def __init__(self, file: IO[bytes], max_bytes: int) -> None:
        super().__init__(fileobj=file, mode="rb")
        self._max_bytes = max_bytes
        self.last_read = b""

    def read(self, size: int | None = -1) -> bytes:
        """At most `CHUNK_BYTES` at once: what tarfile reads in one piece, it keeps in memory."""
        if size is None or not 0 <= size <= CHUNK_BYTES:
            raise UnsafeArchiveError(f"a header of {size} bytes")
        self.last_read = super().read(size)
        if self.tell() > self._max_bytes:
            raise UnsafeArchiveError(f"more than {self._max_bytes / 1e6:.0f} MB once unpacked")
        return self.last_read


def unpack(archive: Path, folder: Path, on_progress: UnpackProgress) -> None:
    """Unpack a .tgz into a new `folder`.

    Raises DamagedArchiveError, UnsafeArchiveError or UserFacingError (such as: the disk is full);
    what has been unpacked by then is left there.
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


def _unpack_all(stream: _BoundedGzip, folder: Path, tick: Callable[[], None]) -> None:
    with tarfile.open(fileobj=stream, mode="r:", tarinfo=_CheckedHeader) as tar:
        for count, member in enumerate(tar):
            if count == MAX_MEMBERS:
                raise UnsafeArchiveError(f"more than {MAX_MEMBERS} files")
            _unpack_one(tar, member, folder, tick)
    # A header that makes no sense ends tarfile's loop as the end itself does; then reading on to
    # the end of the stream also has its checksum compared.
    while not any(stream.last_read):
        if not stream.read(CHUNK_BYTES):
            return
    raise DamagedArchiveError("a header cannot be read")


def _unpack_one(
    tar: tarfile.TarFile, member: tarfile.TarInfo, folder: Path, tick: Callable[[], None]
) -> None:
    path = folder / safe_path(member.name)
    if member.type == tarfile.DIRTYPE:
        path.mkdir(parents=True, exist_ok=True)
        return
    if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or member.issparse():
        raise UnsafeArchiveError(f"{member.name!r}, which is neither a file nor a folder")
    path.parent.mkdir(parents=True, exist_ok=True)
    source = tar.extractfile(member)
    assert source is not None  # it is a file
    with source, path.open("xb") as target:
        while data := source.read(CHUNK_BYTES):
            target.write(data)
            tick()


def safe_path(name: str) -> PurePosixPath:
    """A member's path, which lies below the folder. Raises UnsafeArchiveError."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        raise UnsafeArchiveError(f"{name!r}, which lies outside its folder")
    if any(len(part.encode(errors="surrogateescape")) > MAX_NAME_BYTES for part in path.parts):
        raise UnsafeArchiveError(f"{name[:40]!r}..., whose name is too long")
    return path
