"""A Kinect's motor, light and accelerometer beside its camera, whatever becomes of either."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from drivers.errors import CameraError, UserFacingError
from drivers.gravity import Vector
from drivers.kinect_usb.audio_motor import AudioMotor
from drivers.kinect_usb.base_device import BaseDevice, BaseReading
from drivers.kinect_usb.devices import find_kinect
from drivers.kinect_usb.gravity import GravityMeter
from drivers.kinect_usb.ids import Role
from drivers.kinect_usb.motor import Motor
from drivers.sensor_settings import Led, SensorSettings

READ_EVERY_S, LOOK_AGAIN_S = 0.1, 2.0
READINGS_AT_ONCE = 8
# How long the head may take from one end to the other: until then, readings just past mislead.
TILTING_TAKES_S = 4.0
JOIN_TIMEOUT_S = 3.0
_log = logging.getLogger(__name__)


def open_base_device(serial: str) -> BaseDevice:
    """The base of the Kinect `serial`, "" for the first one.

    Raises CameraError (not there, no permission, no firmware), UserFacingError without libusb.
    """
    kinect = find_kinect(serial)
    if kinect.base is None:
        raise CameraError(
            f"{kinect.name}: its motor and accelerometer are not on the USB; unplug it and plug it "
            "in again"
        )
    make = Motor if kinect.base.id.role is Role.MOTOR else AudioMotor
    return make(kinect.base.handle, f"{kinect.model} {kinect.base.id.role}")


class KinectBase:
    """See `Base`. A thread of its own reads it, and looks for it again when it has gone."""

    exists = True

    def __init__(self, open_device: Callable[[str], BaseDevice] = open_base_device) -> None:
        self._open_device = open_device
        self._serial = ""
        self._settings: SensorSettings | None = None
        self._device: BaseDevice | None = None
        self._lock = threading.Lock()  # one exchange with the device at a time
        self._meter = GravityMeter()
        self._troubles = _Troubles()
        self._stop = threading.Event()
        self._thread = threading.Thread()

    @property
    def gravity_m_s2(self) -> Vector | None:
        """See `Base`; never waits. In a mirrored picture, left and right are swapped here too."""
        gravity = self._meter.at(time.monotonic())
        settings = self._settings
        if gravity is None or settings is None or not settings.mirror:
            return gravity
        return (-gravity[0], gravity[1], gravity[2])

    def open(self, serial: str) -> None:
        """See `Base`."""
        self.close()
        self._serial, self._settings, self._troubles = serial, None, _Troubles()
        self._stop = threading.Event()
        self._work(READINGS_AT_ONCE)
        self._thread = threading.Thread(
            target=self._run, args=(self._stop,), name="kinect-base", daemon=True
        )
        self._thread.start()

    def apply(self, settings: SensorSettings) -> None:
        """See `Base`."""
        self._settings = settings
        with self._lock:
            if self._device is not None:
                self._trying(self._device, lambda device: self._set_up(device, settings))

    def set_led(self, led: Led) -> None:
        """See `Base`."""
        with self._lock:
            self._remember(led=led)
            self._present().set_led(led)

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """See `Base`."""
        with self._lock:
            self._remember(tilt_deg=tilt_deg)
            self._tilt(self._present(), tilt_deg)

    def read(self) -> BaseReading:
        """Tilt and accelerometer now. Raises CameraError as `set_led`."""
        with self._lock:
            return self._present().read()

    def close(self) -> None:
        """See `Base`."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_TIMEOUT_S)
        self._meter.forget()

    def _run(self, stop: threading.Event) -> None:
        """Body of the thread; it lets go of the device itself, so that nobody waits for it."""
        while not stop.wait(LOOK_AGAIN_S if self._device is None else READ_EVERY_S):
            self._work(1)
        with self._lock:
            if self._device is not None and self._settings is not None:
                self._trying(self._device, lambda device: device.set_led(Led.OFF))
            self._let_go()

    def _work(self, readings: int) -> None:
        """Read the device, found first where it was away."""
        with self._lock:
            try:
                device = self._device or self._find()
            except UserFacingError as error:
                self._troubles.begin(str(error))
            else:
                self._trying(device, lambda device: self._measure(device, readings))

    def _find(self) -> BaseDevice:
        self._device = self._open_device(self._serial)
        if self._settings is not None:
            self._set_up(self._device, self._settings)
        return self._device

    def _trying(self, device: BaseDevice, action: Callable[[BaseDevice], None]) -> None:
        try:
            action(device)
        except UserFacingError as error:
            self._troubles.begin(str(error))
            self._let_go()

    def _let_go(self) -> None:
        self._meter.forget()
        if self._device is not None:
            self._device.close()
            self._device = None

    def _present(self) -> BaseDevice:
        if self._device is None:
            raise CameraError("the Kinect's motor is not there now; it is being looked for")
        return self._device

    def _remember(self, **changed: Any) -> None:
        """For when it is back; nothing is kept from before `apply`."""
        if self._settings is not None:
            self._settings = replace(self._settings, **changed)

    def _set_up(self, device: BaseDevice, settings: SensorSettings) -> None:
        device.set_led(settings.led)
        if settings.tilt_deg is not None:
            self._tilt(device, settings.tilt_deg)

    def _tilt(self, device: BaseDevice, tilt_deg: float) -> None:
        device.set_tilt_deg(tilt_deg)
        self._meter.expect_motion(until_s=time.monotonic() + TILTING_TAKES_S)

    def _measure(self, device: BaseDevice, readings: int) -> None:
        found = [self._take(device.read()) for _ in range(readings)]
        if any(found):
            self._troubles.end(f"{device.name}: gives gravity again")
        elif readings == READINGS_AT_ONCE:
            self._troubles.begin(f"{device.name}: gives no gravity; the first view counts as level")

    def _take(self, reading: BaseReading) -> bool:
        return self._meter.add(reading.gravity_m_s2, time.monotonic(), reading.is_moving)


class _Troubles:
    """Says the first of a run of troubles, and when they are over."""

    def __init__(self) -> None:
        self._are_told = False

    def begin(self, text: str) -> None:
        _log.log(logging.DEBUG if self._are_told else logging.WARNING, "%s", text)
        self._are_told = True

    def end(self, text: str) -> None:
        if self._are_told:
            _log.info("%s", text)
        self._are_told = False
