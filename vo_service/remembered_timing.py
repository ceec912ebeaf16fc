"""The timing that a live service has learned of a sensor: one file per serial number."""

import logging
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from drivers.camera import RgbdFrame, TimingPrior, TimingSource
from drivers.core.config import SCHEMA_VERSION, read_toml
from drivers.core.errors import InputError, UserFacingError
from drivers.core.fields import Field
from drivers.core.files import atomic_write, state_folder

# The exposure may be another one at the next start, so remembered values are at best this certain.
MIN_REMEMBERED_SIGMAS_S = (0.002, 0.001)
SUFFIX = ".toml"
# Parent of the state folders of services that systemd runs.
SYSTEMD_STATE_FOLDERS = Path("/var/lib")
logger = logging.getLogger(__name__)
# Digits of saved seconds, below the accuracy.
_DIGITS = 6


@dataclass(frozen=True)
class RememberedTiming:
    """The learned timing of one sensor; its values are as in a camera file."""

    serial: Annotated[str, "serial number of the sensor"]
    readout_s: Annotated[
        float, Field("seconds from the first row to the last", minimum=0.0, maximum=1.0)
    ]
    depth_offset_s: Annotated[
        float, Field("capture time of depth minus its stamp", minimum=-0.1, maximum=0.1)
    ]
    readout_sigma_s: Annotated[
        float, Field("standard deviation of readout_s", exclusive_minimum=0.0, maximum=1.0)
    ]
    depth_offset_sigma_s: Annotated[
        float, Field("standard deviation of depth_offset_s", exclusive_minimum=0.0, maximum=1.0)
    ]

    @property
    def prior(self) -> TimingPrior:
        """The prior of the next frames."""
        readout_sigma_s, depth_offset_sigma_s = MIN_REMEMBERED_SIGMAS_S
        return TimingPrior(
            self.depth_offset_s,
            max(self.readout_sigma_s, readout_sigma_s),
            max(self.depth_offset_sigma_s, depth_offset_sigma_s),
            TimingSource.MEMORY,
        )

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame of this sensor with the remembered timing, unless its file tells one."""
        told = frame.timing_prior
        if told is None or told.source is not TimingSource.SENSOR:
            return frame
        return replace(
            frame,
            readout_s=self.readout_s,
            skew_s=frame.skew_s - told.depth_offset_s + self.depth_offset_s,
            timing_prior=self.prior,
        )

    def has_changed(self, before: "RememberedTiming") -> bool:
        """Whether a value differs by more than its standard deviation."""
        return (
            abs(self.readout_s - before.readout_s) > self.readout_sigma_s
            or abs(self.depth_offset_s - before.depth_offset_s) > self.depth_offset_sigma_s
        )


def timing_folder(state_folder: Path) -> Path:
    """Return the folder of the files below the service's state folder."""
    return state_folder / "timing"


def memory_folders() -> list[Path]:
    """Return the existing folders of this user's services, and of those of systemd if readable."""
    folders = list(SYSTEMD_STATE_FOLDERS.glob("kinect-vo*"))
    with suppress(UserFacingError):
        folders.append(state_folder())
    return [timing_folder(folder) for folder in dict.fromkeys(folders)]


def find_remembered_timings(folders: Iterable[Path]) -> dict[str, RememberedTiming]:
    """Find what services have learned, by serial number; the newest of each. Damaged files warn."""
    found: dict[str, tuple[float, RememberedTiming]] = {}
    for folder in folders:
        for path in _list_files(folder):
            try:
                written_s = path.stat().st_mtime
                timing = read_toml(path, RememberedTiming)
            except (OSError, InputError) as error:
                logger.warning("%s", error)
                continue
            if timing.serial not in found or written_s > found[timing.serial][0]:
                found[timing.serial] = written_s, timing
    return {serial: timing for serial, (_, timing) in found.items()}


def _list_files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix == SUFFIX)
    except OSError:
        return []


def timing_file(folder: Path, serial: str) -> Path:
    """Return the path of a sensor's file, whatever characters its serial number has."""
    return folder / f"{quote(serial, safe='')}{SUFFIX}"


def read_remembered_timing(folder: Path, serial: str) -> RememberedTiming | None:
    """Read a sensor's timing; None if there is none.

    Raises:
        InputError: The file is damaged, or that of another sensor; the message names it.
    """
    path = timing_file(folder, serial)
    try:
        timing = read_toml(path, RememberedTiming)
    except InputError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise
    if timing.serial != serial:
        raise InputError(f"{path}: is the file of the sensor {timing.serial!r}; delete it")
    return timing


def write_remembered_timing(folder: Path, timing: RememberedTiming) -> None:
    """Write a sensor's timing. Raises OSError; an existing file is then unchanged."""
    values = {field.name: getattr(timing, field.name) for field in fields(timing)}
    lines = [
        f"{name} = {round(value, _DIGITS)!r}"
        for name, value in values.items()
        if isinstance(value, float)
    ]
    text = "\n".join(
        (
            "# Written by kinect-vo run: the learned timing of a sensor. To forget it, stop the",
            "# service and delete this file.",
            f"schema = {SCHEMA_VERSION}",
            f"serial = {_quote_toml(timing.serial)}",
            *lines,
            "",
        )
    )
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    atomic_write(timing_file(folder, timing.serial), text.encode())


def _quote_toml(text: str) -> str:
    escaped = "".join(
        character
        if character.isprintable() and character not in '"\\'
        else f"\\U{ord(character):08x}"
        for character in text
    )
    return f'"{escaped}"'
