"""A Kinect that is not there: the real libfreenect and the real pyusb run on it.

    film = wire_film(folder, [(bgr, depth_mm), ...])
    with PlayedKinect(folder, film) as kinect:
        subprocess.run(command, env=os.environ | kinect.environment)   # in another process, or
        kinect.load()                                       # in this one and those it starts

Another process: `environment` puts a libusb-1.0 of our own before the system's, and names the
control file. This process: `load` does the same; call it before libfreenect or pyusb is loaded for
the first time. Each test may then have a Kinect of its own: libusb's users see the one loaded last
at their next look at the bus.

What it is        model, serial (of the camera on the 1414, else of the audio device), registration:
                  FACTORY, or IDENTITY where the depth given is registered to color already
Settings          rate, loop, start_ticks, start_delay_s, color_offset_s, clock_error_ppm,
                  tilt_deg_per_s, patient: to be set before streaming
                  set_accelerometer, rewind: at any time
Faults            unplug, plug, lose_packets, lose_burst, stall, freeze_control, busy, forbid,
                  starve, slow_bus, kernel_driver, firmware: at any time
Readings          tilt_deg, tilt_moving, led, frames_sent, packets_lost, streaming, open_handles,
                  submitted_transfers, abandoned_transfers

The film begins with frame 0 when the first stream is switched on, and goes on from there as the
world does, unplugged or not; `rewind` lets it begin anew. What comes back of a frame:
`quantised_mm(depth_mm, film.scale)` (depth_scale.py), and color through libfreenect's demosaic of
`bayer(bgr)` (wire_film.py). `write_fitted_usb_frames` (film_sources.py) gives the Kinect the constants of the
one that made a recording, so that its depth comes back within a millimetre.
"""

import ctypes
import os
import uuid
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.simulators.kinect_control import ControlField, SecondsField, create_control
from tests.simulators.kinect_faults import (
    KinectFaultControls,
    KinectLed,
    KinectReadings,
    KinectStream,
)
from tests.simulators.kinect_registration import FACTORY, IDENTITY, RegistrationTable
from tests.simulators.libusb_build import SONAME, libusb_folder
from tests.simulators.raw_depth import CONST_SHIFT
from tests.simulators.usb_frames import UsbFrames, write_usb_frames

__all__ = [
    "COUNTS_PER_G",
    "FACTORY",
    "IDENTITY",
    "KinectLed",
    "KinectModel",
    "KinectSimulator",
    "KinectStream",
    "LoopMode",
    "UsbFrames",
    "simulator_environment",
    "write_usb_frames",
]

CONTROL_VARIABLE = "PLAYED_KINECT"
COUNTS_PER_G = 819
NO_CAMERA_SERIAL = "0000000000000000"  # what the later models' cameras say


class KinectModel(IntEnum):
    """Which Kinect for the first version of the sensor."""

    K1414 = 0  # a motor device of its own
    K1473 = 1  # the audio device moves the motor, once it has its firmware
    K4W = 2  # Kinect for Windows, 1517


class LoopMode(IntEnum):
    """What follows the end of the film."""

    ONCE = 0  # nothing: the camera falls silent
    REPEAT = 1  # its beginning
    THERE_AND_BACK = 2  # the way back to the beginning: motion without a jump


class KinectSimulator(KinectFaultControls, KinectReadings):
    """One Kinect, plugged in from the beginning. Use as a context manager.

    rate             frames a second: a divisor of 60 million, at most 30
    loop             what follows the film's end (Loop): True, its beginning; False, nothing
    start_ticks      what its 60 MHz clock says at the first frame after plugging in
    start_delay_s    from the command to stream until the first frame begins
    color_offset_s  how much later than depth a color frame begins; its stamp says so too
    clock_error_ppm  how much too fast its clock runs
    tilt_deg_per_s   how fast the motor is
    patient          True: a program that is late loses nothing; else what came meanwhile, as on
                     a real bus, is lost after 32 ms
    """

    rate = ControlField("rate")
    loop = ControlField("loop")
    start_ticks = ControlField("start_ticks")
    start_delay_s = SecondsField("start_delay_ns")
    clock_error_ppm = ControlField("clock_error_ppm")
    tilt_deg_per_s = ControlField("tilt_deg_per_s")
    waits_for_reader = ControlField("patient")

    def __init__(
        self,
        folder: Path,
        frames: UsbFrames,
        model: KinectModel = KinectModel.K1414,
        serial: str = "A00123456789012A",
        registration: RegistrationTable = FACTORY,
    ) -> None:
        """Make the control file in `folder`. Raises UserFacingError without a C compiler."""
        self._libusb = libusb_folder()
        self.control_file = folder / f"kinect-{uuid.uuid4().hex[:12]}"
        self._control = create_control(self.control_file)
        self._outer_environment: dict[str, str | None] = {}
        self.model = model
        self.serial = serial
        self.film = frames
        self._write_description(registration)
        self.rate = 30
        self.loop = LoopMode.REPEAT
        self.start_delay_s = 0.1
        self.tilt_deg_per_s = 30
        self.set_firmware_loaded(True)
        self.set_accelerometer(0, COUNTS_PER_G, 0)
        self.plug()

    def _write_description(self, registration: RegistrationTable) -> None:
        control = self._control
        camera_serial = self.serial if self.model == KinectModel.K1414 else NO_CAMERA_SERIAL
        control.model = self.model
        control.camera_serial = camera_serial.encode()
        control.audio_serial = self.serial.encode()
        control.film = str(self.film.file.resolve()).encode()
        control.registration[:] = registration.polynomial
        control.const_shift = CONST_SHIFT
        control.zero_plane[:] = registration.zero_plane(self.film.scale)

    @property
    def environment(self) -> dict[str, str]:
        """Variables for another process, beside those it has."""
        return simulator_environment(self)

    def activate(self) -> None:
        """Let this very process and those it starts see it, and no other USB device.

        Raises RuntimeError if the system's libusb is loaded already: it cannot be replaced then.
        """
        library = str(self._libusb / SONAME)
        for line in Path("/proc/self/maps").read_text().splitlines():
            if f"/{SONAME}" in line and not line.endswith(library):
                raise RuntimeError(f"this process runs on another libusb already: {line}")
        ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
        for name, value in self.environment.items():
            self._outer_environment.setdefault(name, os.environ.get(name))
            os.environ[name] = value

    @property
    def color_offset_s(self) -> float:
        """How much later than depth a color frame begins; negative: earlier."""
        offset_ns: int = self._control.streams[KinectStream.COLOR].offset_ns
        return offset_ns / 1e9

    @color_offset_s.setter
    def color_offset_s(self, offset_s: float) -> None:
        self._control.streams[KinectStream.COLOR].offset_ns = round(offset_s * 1e9)

    def set_accelerometer(self, x: int, y: int, z: int) -> None:
        """Counts as on the wire, 819 a g. Level and at rest: 0, 819, 0."""
        self._control.acceleration[:] = (x, y, z)

    def rewind(self) -> None:
        """Let the film begin with frame 0 when a stream is switched on the next time."""
        self._control.film_began_ns = 0
        self._control.clock_began_frame = -1

    def close(self) -> None:
        """Unplug it; after `load`, give the process its environment back."""
        self.unplug()
        for name, value in self._outer_environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        self._outer_environment.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def simulator_environment(*kinects: KinectSimulator) -> dict[str, str]:
    """Variables for a process that sees these Kinects, each on a bus of its own."""
    files = ":".join(str(kinect.control_file) for kinect in kinects)
    return {"LD_LIBRARY_PATH": str(libusb_folder()), CONTROL_VARIABLE: files}
