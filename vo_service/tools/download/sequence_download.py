"""One sequence: brought here, checked, unpacked beside its place, then put there in one step."""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import InputError, UserFacingError
from drivers.core.paths import create_output_folder
from drivers.tum.folder import open_tum_folder
from vo_service.tools.download.archive import DamagedArchiveError, UnsafeArchiveError, unpack
from vo_service.tools.download.catalog import BENCHMARK_URL, BenchmarkSequence
from vo_service.tools.download.partial_file import PartialFile, disk_error
from vo_service.tools.download.progress import DownloadProgress
from vo_service.tools.download.transfer import fetch_with_retries


@dataclass(frozen=True)
class DownloadRequest:
    """What is wanted.

    output  the folder that the sequences' own folders go into
    source  address that stands for the benchmark's host
    sha256  what the archive's digest must be, in hexadecimal; empty for any
    """

    output: Path
    source: str = BENCHMARK_URL
    sha256: str = ""


def sequence_folder(sequence: BenchmarkSequence, request: DownloadRequest) -> Path:
    """The folder that the sequence has, or will have."""
    return request.output / sequence.folder


def download_sequence(
    sequence: BenchmarkSequence, request: DownloadRequest, progress: DownloadProgress
) -> Path:
    """The sequence's folder, which appears under its name only when whole.

    One that is there already is left as it is. Whenever this is ended, what has come is kept for
    the next time, unless it has proved to be of no use. Raises UserFacingError.
    """
    place = sequence_folder(sequence, request)
    create_output_folder(request.output)
    with PartialFile(request.output / f".{sequence.folder}.tgz.part") as part:
        if not place.exists():
            url = sequence.url(request.source)
            fetch_with_retries(url, part, progress.show_transfer)
            try:
                _check_digest(part.path, request.sha256)
                _unpack_into(place, part.path, progress)
            except (DamagedArchiveError, UnsafeArchiveError) as error:
                part.discard()
                raise _unusable_archive_error(url, error) from error
        part.discard()
    return place


def _check_digest(archive: Path, sha256: str) -> None:
    if not sha256:
        return
    with archive.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != sha256.lower():
        raise DamagedArchiveError(f"its SHA-256 is {found}")


def _unpack_into(folder: Path, archive: Path, progress: DownloadProgress) -> None:
    """Unpack, see that it can be replayed, and only then give it its name."""
    beside = folder.with_name(f".{folder.name}.unpacking")
    shutil.rmtree(beside, ignore_errors=True)  # of one that was killed
    try:
        unpack(archive, beside, progress.show_unpacking)
        # Its camera is known by its name, whatever the archive calls it.
        recording = _find_recording(beside).rename(beside / folder.name)
        _check_recording(recording)
        recording.rename(folder)
    except OSError as error:
        raise disk_error(folder.parent, error) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _find_recording(folder: Path) -> Path:
    """The one recording that was unpacked. Raises UnsafeArchiveError if there is none, or more."""
    found = [lists.parent for lists in sorted(folder.glob("*/rgb.txt"))]
    if len(found) != 1:
        raise UnsafeArchiveError(f"{len(found) or 'no'} recordings in TUM format")
    return found[0]


def _check_recording(recording: Path) -> None:
    try:
        open_tum_folder(recording, None)
    except InputError as error:
        told = str(error).replace(str(recording), recording.name)
        raise UnsafeArchiveError(f"nothing that can be replayed ({told})") from error


def _unusable_archive_error(url: str, error: UserFacingError) -> UserFacingError:
    if isinstance(error, DamagedArchiveError):
        return UserFacingError(
            f"{url}: the archive is damaged ({error}) and has been removed; give the same command "
            "again, or another source with --mirror"
        )
    return UserFacingError(
        f"{url}: the archive is refused and has been removed: it holds {error}; give another "
        "source with --mirror"
    )
