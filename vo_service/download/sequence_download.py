"""One sequence: brought here, checked, unpacked beside its place, then put there in one step."""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError, UserFacingError
from drivers.tum.folder import open_folder
from vo_service.download.catalogue import HOST, BenchmarkSequence
from vo_service.download.meter import Meter
from vo_service.download.partial_file import PartialFile, disk_error
from vo_service.download.transfer import fetch_patiently
from vo_service.download.unpacking import DamagedArchiveError, UnsafeArchiveError, unpack
from vo_service.folders import make_output_folder


@dataclass(frozen=True)
class Order:
    """What is wanted.

    output  the folder that the sequences' own folders go into
    source  address that stands for the benchmark's host
    sha256  what the archive's digest must be, in hexadecimal; empty for any
    """

    output: Path
    source: str = HOST
    sha256: str = ""


def place_of(sequence: BenchmarkSequence, order: Order) -> Path:
    """The folder that the sequence has, or will have."""
    return order.output / sequence.folder


def download(sequence: BenchmarkSequence, order: Order, meter: Meter) -> Path:
    """The sequence's folder, which appears under its name only when whole.

    One that is there already is left as it is. Whenever this is ended, what has come is kept for
    the next time, unless it has proved to be of no use. Raises UserFacingError.
    """
    place = place_of(sequence, order)
    make_output_folder(order.output)
    with PartialFile(order.output / f".{sequence.folder}.tgz.part") as part:
        if not place.exists():
            url = sequence.url(order.source)
            fetch_patiently(url, part, meter.transfer)
            try:
                _check_digest(part.path, order.sha256)
                _unpack_into(place, part.path, meter)
            except (DamagedArchiveError, UnsafeArchiveError) as error:
                part.discard()
                raise _useless(url, error) from error
        part.discard()
    return place


def _check_digest(archive: Path, sha256: str) -> None:
    if not sha256:
        return
    with archive.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != sha256.lower():
        raise DamagedArchiveError(f"its SHA-256 is {found}")


def _unpack_into(place: Path, archive: Path, meter: Meter) -> None:
    """Unpack, see that it can be replayed, and only then give it its name."""
    beside = place.with_name(f".{place.name}.unpacking")
    shutil.rmtree(beside, ignore_errors=True)  # of one that was killed
    try:
        unpack(archive, beside, meter.unpacking)
        # Its camera is known by its name, whatever the archive calls it.
        recording = _recording_in(beside).rename(beside / place.name)
        _check(recording)
        recording.rename(place)
    except OSError as error:
        raise disk_error(place.parent, error) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _recording_in(folder: Path) -> Path:
    """The one recording that was unpacked. Raises UnsafeArchiveError if there is none, or more."""
    found = [lists.parent for lists in sorted(folder.glob("*/rgb.txt"))]
    if len(found) != 1:
        raise UnsafeArchiveError(f"{len(found) or 'no'} recordings in TUM format")
    return found[0]


def _check(recording: Path) -> None:
    try:
        open_folder(recording, None)
    except InputError as error:
        told = str(error).replace(str(recording), recording.name)
        raise UnsafeArchiveError(f"nothing that can be replayed ({told})") from error


def _useless(url: str, error: UserFacingError) -> UserFacingError:
    if isinstance(error, DamagedArchiveError):
        return UserFacingError(
            f"{url}: the archive is damaged ({error}) and has been removed; give the same command "
            "again, or another source with --mirror"
        )
    return UserFacingError(
        f"{url}: the archive is refused and has been removed: it holds {error}; give another "
        "source with --mirror"
    )
