"""Memory of what a live service learns of a sensor, timing and focal length: a file per sensor."""

import logging
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from drivers.camera import FocalPrior, RgbdFrame, TimingPrior, TimingSource
from drivers.core import InputError, UserFacingError
from drivers.core.config import SCHEMA_VERSION, Field, read_toml
from drivers.core.files import atomic_write
from drivers.core.folders import state_folder
from drivers.core.queues import DropOldestQueue, WorkerThread
from drivers.core.write_errors import WriteError, writing
from vo_service.odometry.registry import FIXED_TIMING_MODE
from vo_service.types.estimate import LEARNED_TIMING
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import NullSensorMemory, OutputBase, SensorMemory

# The exposure may be another one at the next start, so remembered values are at best this certain.
MIN_REMEMBERED_SIGMAS_S = (0.002, 0.001)
# A lens distortion that nobody told moves the learned focal length by about this.
MIN_REMEMBERED_FOCAL_SIGMA = 0.01
# Focal lengths of frames that differ by less are the same, pixels.
SAME_FOCAL_PX = 1e-3
SUFFIX = ".toml"
# Parent of the state folders of services that systemd runs.
SYSTEMD_STATE_FOLDERS = Path("/var/lib")
logger = logging.getLogger(__name__)
# Digits of saved numbers, below the accuracy.
_DIGITS = 6


@dataclass(frozen=True)
class RememberedFocalLength:
    """The learned focal length of one sensor's color camera."""

    fx: Annotated[
        float, Field("fx of the intrinsics with which it was learned", minimum=1.0, maximum=1e6)
    ]
    scale: Annotated[
        float, Field("learned focal length by that of the intrinsics", minimum=0.5, maximum=2.0)
    ]
    sigma: Annotated[
        float, Field("standard deviation of scale", exclusive_minimum=0.0, maximum=1.0)
    ]
    disagreement: Annotated[float, "the same by depth minus that by brightness"]

    @property
    def prior_sigma(self) -> float:
        """Standard deviation of `scale` for other frames than those it was learned from."""
        return max(self.sigma, MIN_REMEMBERED_FOCAL_SIGMA)

    def prior_for(self, fx: float) -> FocalPrior | None:
        """Return the prior of frames with this fx; None if it is not that of the intrinsics."""
        if self.scale == 1.0 or abs(fx - self.fx) > SAME_FOCAL_PX:
            return None
        return FocalPrior(self.scale, self.prior_sigma)


@dataclass(frozen=True)
class RememberedSensor:
    """What was learned of one sensor; the timing is as in a camera file."""

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
    focal_length: Annotated[
        RememberedFocalLength | None, "of the color camera; unset until it is certain"
    ] = None
    accelerometer_bias_m_s2: Annotated[
        tuple[float, float, float] | None,
        "bias of the accelerometer in camera axes; unset until a floor has shown it",
    ] = None

    @property
    def timing_prior(self) -> TimingPrior:
        """The timing prior of the next frames."""
        readout_sigma_s, depth_offset_sigma_s = MIN_REMEMBERED_SIGMAS_S
        return TimingPrior(
            self.depth_offset_s,
            max(self.readout_sigma_s, readout_sigma_s),
            max(self.depth_offset_sigma_s, depth_offset_sigma_s),
            TimingSource.MEMORY,
        )

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame of this sensor with what was learned and its camera file does not tell.

        Its file tells the focal length if it is not that with which it was learned.
        """
        if self.focal_length is not None:
            prior = self.focal_length.prior_for(frame.camera.fx)
            frame = frame if prior is None else replace(frame, focal_prior=prior)
        if self.accelerometer_bias_m_s2 is not None:
            frame = replace(frame, accelerometer_bias_m_s2=self.accelerometer_bias_m_s2)
        return self._apply_timing(frame)

    def _apply_timing(self, frame: RgbdFrame) -> RgbdFrame:
        told = frame.timing_prior
        if told is None or told.source is not TimingSource.SENSOR:
            return frame
        return replace(
            frame,
            readout_s=self.readout_s,
            skew_s=frame.skew_s - told.depth_offset_s + self.depth_offset_s,
            timing_prior=self.timing_prior,
        )

    def has_changed(self, before: "RememberedSensor") -> bool:
        """Whether a value differs by more than its standard deviation, or is new."""
        focal_length, focal_before = self.focal_length, before.focal_length
        if focal_length is not None and (
            focal_before is None
            or abs(focal_length.fx - focal_before.fx) > SAME_FOCAL_PX
            or abs(focal_length.scale - focal_before.scale) > focal_length.sigma
        ):
            return True
        if (self.accelerometer_bias_m_s2 is None) != (before.accelerometer_bias_m_s2 is None):
            return True
        return (
            abs(self.readout_s - before.readout_s) > self.readout_sigma_s
            or abs(self.depth_offset_s - before.depth_offset_s) > self.depth_offset_sigma_s
        )


def sensor_folder(state_folder: Path) -> Path:
    """Return the folder of the files below the service's state folder."""
    return state_folder / "sensors"


def memory_folders() -> list[Path]:
    """Return the existing folders of this user's services, and of those of systemd if readable."""
    folders = list(SYSTEMD_STATE_FOLDERS.glob("kinect-vo*"))
    with suppress(UserFacingError):
        folders.append(state_folder())
    return [sensor_folder(folder) for folder in dict.fromkeys(folders)]


def find_remembered_sensors(folders: Iterable[Path]) -> dict[str, RememberedSensor]:
    """Find what services have learned, by serial number; the newest of each. Damaged files warn."""
    found: dict[str, tuple[float, RememberedSensor]] = {}
    for folder in folders:
        for path in _list_files(folder):
            try:
                written_s = path.stat().st_mtime
                sensor = read_toml(path, RememberedSensor)
            except (OSError, InputError) as error:
                logger.warning("%s", error)
                continue
            if sensor.serial not in found or written_s > found[sensor.serial][0]:
                found[sensor.serial] = written_s, sensor
    return {serial: sensor for serial, (_, sensor) in found.items()}


def _list_files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.suffix == SUFFIX)
    except OSError:
        return []


def sensor_file(folder: Path, serial: str) -> Path:
    """Return the path of a sensor's file, whatever characters its serial number has."""
    return folder / f"{quote(serial, safe='')}{SUFFIX}"


def read_remembered_sensor(folder: Path, serial: str) -> RememberedSensor | None:
    """Read what was learned of a sensor; None if there is nothing.

    Raises:
        InputError: The file is damaged, or that of another sensor; the message names it.
    """
    path = sensor_file(folder, serial)
    try:
        sensor = read_toml(path, RememberedSensor)
    except InputError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise
    if sensor.serial != serial:
        raise InputError(f"{path}: is the file of the sensor {sensor.serial!r}; delete it")
    return sensor


def write_remembered_sensor(folder: Path, sensor: RememberedSensor) -> None:
    """Write what was learned of a sensor. Raises WriteError; an existing file is then unchanged."""
    lines = [
        "# Written by kinect-vo run: what was learned of a sensor. To forget it, stop the service",
        "# and delete this file.",
        f"schema = {SCHEMA_VERSION}",
        f"serial = {_quote_toml(sensor.serial)}",
        *_format_numbers(sensor),
    ]
    if sensor.accelerometer_bias_m_s2 is not None:
        values = [round(value, _DIGITS) for value in sensor.accelerometer_bias_m_s2]
        lines.append(f"accelerometer_bias_m_s2 = {values!r}")
    if sensor.focal_length is not None:
        lines += ["", "[focal_length]", *_format_numbers(sensor.focal_length)]
    text = "\n".join((*lines, ""))
    path = sensor_file(folder, sensor.serial)
    with writing(path):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        atomic_write(path, text.encode())


def _format_numbers(table: RememberedSensor | RememberedFocalLength) -> list[str]:
    values = {field.name: getattr(table, field.name) for field in fields(table)}
    return [
        f"{name} = {round(value, _DIGITS)!r}"
        for name, value in values.items()
        if isinstance(value, float)
    ]


def _quote_toml(text: str) -> str:
    escaped = "".join(
        character
        if character.isprintable() and character not in '"\\'
        else f"\\U{ord(character):08x}"
        for character in text
    )
    return f'"{escaped}"'


# Shortest time between two saves during a run.
SAVE_INTERVAL_S = 60.0
# Time limit, at the end, for a disk that hangs.
CLOSE_TIMEOUT_S = 0.5


class SensorFiles(OutputBase):
    """Memory in files, one per sensor.

    A sensor's file is read at its first frame. It is written when the estimate has clearly changed,
    at most once a minute; and when the service ends, or another sensor is plugged in.

    Args:
        folder: Folder of the files; it is made when the first one is written.
        now_s: The clock, s.
    """

    def __init__(self, folder: Path, now_s: Callable[[], float] = time.monotonic) -> None:
        self.warning = ""
        self._folder, self._now_s = folder, now_s
        self._serial = ""
        # Of the present sensor: what was known at its first frame, is in its file, and is newest.
        self._at_start: RememberedSensor | None = None
        self._saved: RememberedSensor | None = None
        self._learned: RememberedSensor | None = None
        self._next_save_s = -float("inf")
        # By serial number: what this run has saved. The file may not be written yet.
        self._saved_here: dict[str, RememberedSensor] = {}
        self._has_failed = False
        self._writer = WorkerThread(
            "sensor memory", DropOldestQueue[RememberedSensor](8), self._write, lambda: None
        )

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame with what an earlier run has learned, see `RememberedSensor.apply`."""
        if frame.serial != self._serial:
            self._save_last()
            self._serial = frame.serial
            self._learned = None
            self._at_start = self._saved = self._read(frame.serial) if frame.serial else None
        return self._at_start.apply(frame) if self._at_start else frame

    def on_update(self, update: OdometryUpdate) -> None:
        """Save the estimate of this frame, if it is certain and has clearly changed."""
        if not self._serial or update.frame.serial != self._serial:
            return
        learned = _learned_of(update, self._learned or self._at_start)
        if learned is None:
            return
        self._learned = learned
        if self._now_s() < self._next_save_s:
            return
        if self._saved is None or self._learned.has_changed(self._saved):
            self._save(self._learned)

    def close(self) -> None:
        """Save the last estimate."""
        self._save_last()
        self._learned = None
        self._writer.close(CLOSE_TIMEOUT_S)

    def _save_last(self) -> None:
        if self._learned is not None and self._learned != self._saved:
            self._save(self._learned)

    def _save(self, sensor: RememberedSensor) -> None:
        self._saved = self._saved_here[sensor.serial] = sensor
        self._next_save_s = self._now_s() + SAVE_INTERVAL_S
        self._writer.put(sensor)

    def _read(self, serial: str) -> RememberedSensor | None:
        if serial in self._saved_here:
            return self._saved_here[serial]
        try:
            return read_remembered_sensor(self._folder, serial)
        except InputError as error:
            self.warning = (
                f"{error} (what an earlier run has learned is lost; the usual values hold)"
            )
            logger.warning("%s", self.warning)
            return None

    def _write(self, sensor: RememberedSensor) -> None:
        """Body of the writer's thread for one save."""
        try:
            write_remembered_sensor(self._folder, sensor)
        except WriteError as error:
            self.warning = f"{error} (what is learned is lost at the end)"
            if not self._has_failed:
                logger.warning("%s", self.warning)
            self._has_failed = True
        else:
            self.warning = ""


def _learned_of(update: OdometryUpdate, before: RememberedSensor | None) -> RememberedSensor | None:
    """Return what was learned until this update, and before; None if nothing is certain.

    The accelerometer's bias is kept with the timing.
    """
    timing, focal_length = update.estimate.timing, update.estimate.focal_length
    if timing is None:
        return None
    remembered_focal = before.focal_length if before else None
    if focal_length is not None and focal_length.disagreement is not None:
        remembered_focal = RememberedFocalLength(
            update.frame.camera.fx,
            focal_length.scale,
            focal_length.sigma,
            focal_length.disagreement,
        )
    elif timing.source != LEARNED_TIMING:
        return None
    return RememberedSensor(
        update.frame.serial,
        timing.readout_s,
        timing.depth_offset_s,
        timing.readout_sigma_s,
        timing.depth_offset_sigma_s,
        remembered_focal,
        update.level.accelerometer_bias_m_s2
        or (before.accelerometer_bias_m_s2 if before else None),
    )


def open_sensor_memory(timing_mode: str) -> SensorMemory:
    """Open the memory in the state folder; a `NullSensorMemory` if it is off or fails.

    Args:
        timing_mode: One of `TIMING_MODES`; nothing is remembered with a fixed timing.
    """
    if timing_mode == FIXED_TIMING_MODE:
        return NullSensorMemory()
    try:
        return SensorFiles(sensor_folder(state_folder()))
    except UserFacingError as error:
        warning = f"memory of sensors: switched off: {error}"
        logger.warning("%s", warning)
        return NullSensorMemory(warning)
