"""A Kinect simulator on which the real libfreenect and the real pyusb run.

    frames = write_usb_frames(folder, [(bgr, depth_mm), ...])
    with KinectSimulator(folder, frames) as kinect:
        subprocess.run(command, env=os.environ | kinect.environment)   # in another process, or
        kinect.activate()                         # in this process and its children

Another process: `environment` puts our own libusb-1.0 before the system's, and names the control
file. This process: `activate` does the same; call it before libfreenect or pyusb is loaded for the
first time. Each test may have its own Kinect: programs see the one activated last when they list
the bus the next time.

Settings, before streaming: rate, loop, start_ticks, color_offset_s, tilt_deg_per_s,
waits_for_reader; at any time: set_accelerometer, rewind. Faults are in `KinectFaultControls`,
readings in `KinectReadings`.

Playback begins with frame 0 when the first stream is switched on, and continues even while the
Kinect is unplugged. A program receives `quantize_mm(depth_mm, frames.scale)` (raw_depth.py) and the
color that libfreenect demosaics from `to_bayer(bgr)` (usb_frames.py). With
`write_fitted_usb_frames` (frame_sources.py) the Kinect has the constants of the one that made a
recording, so that its depth comes back within a millimeter.
"""

import ctypes
import os
import uuid
from enum import IntEnum
from pathlib import Path
from typing import Self

from tests.simulators.kinect_control import ControlField, create_control
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

CONTROL_VARIABLE = "KINECT_SIMULATOR"
COUNTS_PER_G = 819
NO_CAMERA_SERIAL = "0000000000000000"  # reported by the cameras of the later models


class KinectModel(IntEnum):
    """Models of the Kinect v1."""

    K1414 = 0  # has a separate motor device
    K1473 = 1  # the audio device moves the motor, once its firmware is loaded
    K4W = 2  # Kinect for Windows, 1517


class LoopMode(IntEnum):
    """What follows the last frame."""

    ONCE = 0  # nothing: the camera sends no more frames
    REPEAT = 1  # the first frame
    THERE_AND_BACK = 2  # the frames in reverse order: motion without a jump


class KinectSimulator(KinectFaultControls, KinectReadings):
    """One simulated Kinect, plugged in from the beginning. Use it as a context manager.

    Attributes:
        rate: Frames per second: a divisor of 60 million, at most 30.
        loop: A `LoopMode`, or True for REPEAT and False for ONCE.
        start_ticks: Value of its 60 MHz clock at the first frame after plugging in.
        color_offset_s: How much later than depth a color frame begins, also in its stamp.
        tilt_deg_per_s: Speed of the motor.
        waits_for_reader: True: a late program loses no packets. False: packets are lost after
            32 ms, as on a real bus.
    """

    rate = ControlField("rate")
    loop = ControlField("loop")
    start_ticks = ControlField("start_ticks")
    tilt_deg_per_s = ControlField("tilt_deg_per_s")
    waits_for_reader = ControlField("waits_for_reader")

    def __init__(
        self,
        folder: Path,
        frames: UsbFrames,
        model: KinectModel = KinectModel.K1414,
        serial: str = "A00123456789012A",
        registration: RegistrationTable = FACTORY,
    ) -> None:
        """Create the control file.

        Args:
            folder: Folder of the control file.
            frames: The frames to send.
            model: The model.
            serial: Serial number of the camera on the 1414, else of the audio device.
            registration: FACTORY, or IDENTITY if the depth is registered to color already.

        Raises:
            UserFacingError: There is no C compiler.
        """
        self._libusb = libusb_folder()
        self.control_file = folder / f"kinect-{uuid.uuid4().hex[:12]}"
        self._control = create_control(self.control_file)
        self._outer_environment: dict[str, str | None] = {}
        self.model = model
        self.serial = serial
        self.usb_frames = frames
        self._write_description(registration)
        self.rate = 30
        self.loop = LoopMode.REPEAT
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
        control.recording = str(self.usb_frames.file.resolve()).encode()
        control.registration[:] = registration.polynomial
        control.const_shift = CONST_SHIFT
        control.zero_plane[:] = registration.zero_plane(self.usb_frames.scale)

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables to add for another process."""
        return simulator_environment(self)

    def activate(self) -> None:
        """Make it the only USB device of this process and of its children.

        Raises:
            RuntimeError: The system's libusb is loaded already and cannot be replaced.
        """
        library = str(self._libusb / SONAME)
        for line in Path("/proc/self/maps").read_text().splitlines():
            if f"/{SONAME}" in line and not line.endswith(library):
                raise RuntimeError(f"another libusb is loaded in this process already: {line}")
        ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
        for name, value in self.environment.items():
            self._outer_environment.setdefault(name, os.environ.get(name))
            os.environ[name] = value

    @property
    def color_offset_s(self) -> float:
        """How much later than depth a color frame begins; negative if earlier."""
        offset_ns: int = self._control.streams[KinectStream.COLOR].offset_ns
        return offset_ns / 1e9

    @color_offset_s.setter
    def color_offset_s(self, offset_s: float) -> None:
        self._control.streams[KinectStream.COLOR].offset_ns = round(offset_s * 1e9)

    def set_accelerometer(self, x: int, y: int, z: int) -> None:
        """Set the counts on the wire, 819 per g. Level and at rest they are 0, 819, 0."""
        self._control.acceleration[:] = (x, y, z)

    def rewind(self) -> None:
        """Restart playback with frame 0 when a stream is switched on the next time."""
        self._control.playback_start_ns = 0
        self._control.clock_start_frame = -1

    def close(self) -> None:
        """Unplug it; after `activate`, restore the process's environment."""
        self.unplug()
        for name, value in self._outer_environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        self._outer_environment.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()


def simulator_environment(*kinects: KinectSimulator) -> dict[str, str]:
    """Environment variables for a process that sees these Kinects, each on its own bus."""
    files = ":".join(str(kinect.control_file) for kinect in kinects)
    return {"LD_LIBRARY_PATH": str(libusb_folder()), CONTROL_VARIABLE: files}
