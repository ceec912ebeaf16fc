"""A camera that passes everything on to another camera: the base of those that change a part."""

from collections.abc import Collection, Iterator

from drivers.camera import CameraCounters, CameraStatus, Led, RgbdCamera, RgbdFrame
from drivers.core.geometry import Trajectory


class CameraWrapper(RgbdCamera):
    """Is the camera that it wraps in all that a derived class does not override."""

    def __init__(self, camera: RgbdCamera) -> None:
        self.name, self.clock, self.reconnects = camera.name, camera.clock, camera.reconnects
        self._camera = camera

    def prepare(self) -> None:
        self._camera.prepare()

    def open(self) -> None:
        self._camera.open()

    def read(self, timeout_s: float) -> RgbdFrame:
        return self._camera.read(timeout_s)

    def close(self) -> None:
        self._camera.close()

    def wait_for_reconnect(self, timeout_s: float) -> None:
        self._camera.wait_for_reconnect(timeout_s)

    @property
    def counters(self) -> CameraCounters:
        return self._camera.counters

    @property
    def status(self) -> CameraStatus:
        return self._camera.status

    @property
    def intrinsics_source(self) -> str:
        return self._camera.intrinsics_source

    @property
    def depth_unit_source(self) -> str:
        return self._camera.depth_unit_source

    @property
    def has_motor(self) -> bool:
        return self._camera.has_motor

    def set_tilt_deg(self, tilt_deg: float) -> None:
        self._camera.set_tilt_deg(tilt_deg)

    def set_led(self, led: Led) -> None:
        self._camera.set_led(led)

    @property
    def can_drive(self) -> bool:
        return self._camera.can_drive

    def set_velocity(self, forward_m_s: float, yaw_rad_s: float) -> None:
        self._camera.set_velocity(forward_m_s, yaw_rad_s)

    @property
    def frame_count(self) -> int | None:
        return self._camera.frame_count

    @property
    def ground_truth(self) -> Trajectory | None:
        return self._camera.ground_truth

    def recorded_odometry(self, topics: Collection[str]) -> Iterator[bytes]:
        return self._camera.recorded_odometry(topics)
