"""Download of one sequence: fetch, check, unpack beside the target, then rename in one step."""

import hashlib
import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.core.errors import InputError, UserFacingError
from drivers.core.files import create_output_folder
from drivers.tum.folder import open_tum_folder
from vo_service.terminal import Terminal
from vo_service.tools.download.archive import (
    DamagedArchiveError,
    UnpackProgress,
    UnsafeArchiveError,
    unpack,
)
from vo_service.tools.download.catalog import BENCHMARK_URL, BenchmarkSequence
from vo_service.tools.download.transfer import PartialFile, disk_error, fetch_with_retries


@dataclass(frozen=True)
class DownloadRequest:
    """Settings of a download.

    Attributes:
        output: Folder for the sequences' folders.
        source: Address of the benchmark's host or of a mirror.
        sha256: Required digest of the archive, hexadecimal; empty for any.
    """

    output: Path
    source: str = BENCHMARK_URL
    sha256: str = ""


def sequence_folder(sequence: BenchmarkSequence, request: DownloadRequest) -> Path:
    """Return the folder of the downloaded sequence."""
    return request.output / sequence.folder


def download_sequence(
    sequence: BenchmarkSequence, request: DownloadRequest, terminal: Terminal
) -> Path:
    """Download a sequence and return its folder, which appears only when it is complete.

    An existing folder is not changed. A partial download is kept for the next time, unless the
    archive is unusable.

    Args:
        sequence: The sequence.
        request: Settings of the download.
        terminal: Shows the progress.

    Raises:
        UserFacingError: The download fails.
    """
    folder = sequence_folder(sequence, request)
    create_output_folder(request.output)
    with PartialFile(request.output / f".{sequence.folder}.tgz.part") as part:
        if not folder.exists():
            url = sequence.url(request.source)
            fetch_with_retries(url, part, partial(terminal.progress_bytes, sequence.name))
            try:
                _check_digest(part.path, request.sha256)
                _unpack_into(
                    folder,
                    part.path,
                    partial(terminal.progress_bytes, f"{sequence.name}: unpacking"),
                )
            except (DamagedArchiveError, UnsafeArchiveError) as error:
                part.discard()
                raise _unusable_archive_error(url, error) from error
        part.discard()
    return folder


def _check_digest(archive: Path, sha256: str) -> None:
    if not sha256:
        return
    with archive.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != sha256.lower():
        raise DamagedArchiveError(f"its SHA-256 is {digest}")


def _unpack_into(folder: Path, archive: Path, on_progress: UnpackProgress) -> None:
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
