"""Download of one sequence: fetch, check, unpack beside the target, then rename in one step."""

import hashlib
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import InputError, UserFacingError
from drivers.core.files import create_output_folder
from drivers.tum.folder import open_tum_folder
from vo_service.terminal import REDRAW_S, Terminal
from vo_service.tools.download.archive import DamagedArchiveError, UnsafeArchiveError, unpack
from vo_service.tools.download.catalog import BENCHMARK_URL, BenchmarkSequence
from vo_service.tools.download.transfer import PartialFile, disk_error, fetch_with_retries


class DownloadProgress:
    """Progress line of one sequence, drawn at most ten times a second."""

    def __init__(
        self, terminal: Terminal, name: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._terminal, self._name, self._clock = terminal, name, clock
        self._begin_s, self._begin_bytes = clock(), -1
        self._drawn_s = 0.0

    def show_transfer(self, done: int, total: int | None) -> None:
        """Show the transferred bytes, of the total if it is known."""
        if self._begin_bytes < 0:  # data from an earlier download does not count as speed
            self._begin_s, self._begin_bytes = self._clock(), done
        elapsed_s = max(self._clock() - self._begin_s, 1e-3)
        rate = max(done - self._begin_bytes, 0) / elapsed_s
        text = f"{done / 1e6:.0f} MB"
        if total:
            text = f"{done / 1e6:.0f} of {total / 1e6:.0f} MB ({done / total:.0%})"
        text += f", {rate / 1e6:.1f} MB/s"
        if total and rate > 0:
            text += f", {_format_duration((total - done) / rate)} left"
        self._draw(text)

    def show_unpacking(self, done: int, total: int | None) -> None:
        """Show the fraction of the archive that has been unpacked."""
        self._draw(f"unpacking ({done / total:.0%})" if total else "unpacking")

    def _draw(self, text: str) -> None:
        now_s = self._clock()
        if now_s - self._drawn_s >= REDRAW_S:
            self._drawn_s = now_s
            self._terminal.show(f"{self._name}: {text}")


def _format_duration(seconds: float) -> str:
    minutes = round(seconds) // 60
    return f"{minutes} min" if minutes else f"{seconds:.0f} s"


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
    sequence: BenchmarkSequence, request: DownloadRequest, progress: DownloadProgress
) -> Path:
    """Download a sequence and return its folder, which appears only when it is complete.

    An existing folder is not changed. A partial download is kept for the next time, unless the
    archive is unusable.

    Raises:
        UserFacingError: The download fails.
    """
    folder = sequence_folder(sequence, request)
    create_output_folder(request.output)
    with PartialFile(request.output / f".{sequence.folder}.tgz.part") as part:
        if not folder.exists():
            url = sequence.url(request.source)
            fetch_with_retries(url, part, progress.show_transfer)
            try:
                _check_digest(part.path, request.sha256)
                _unpack_into(folder, part.path, progress)
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


def _unpack_into(folder: Path, archive: Path, progress: DownloadProgress) -> None:
    """Unpack into a temporary folder, check that it can be replayed, then rename it to `folder`."""
    temporary = folder.with_name(f".{folder.name}.unpacking")
    shutil.rmtree(temporary, ignore_errors=True)  # left by a killed process
    try:
        unpack(archive, temporary, progress.show_unpacking)
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
