"""What the cameras in a virtual room have in common: their sensor, its frames and their counts."""

from abc import abstractmethod

from drivers.camera import (
    AccelerometerReading,
    CameraCounters,
    CameraState,
    CameraStatus,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraLostError
from drivers.synthetic.accelerometer import SyntheticAccelerometer
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.sensors import RenderedImages


class VirtualCamera(RgbdCamera):
    """A camera that moves through a virtual room."""

    name = "synthetic"

    def __init__(self, config: SyntheticConfig, motion: CameraMotion) -> None:
        self._config = config
        self._accelerometer = SyntheticAccelerometer(config, motion)
        self._is_open = False
        self._next_seq = 0
        self._counters = CameraCounters()

    @property
    @abstractmethod
    def _is_preparing(self) -> bool:
        """Whether its room is not painted yet."""

    @property
    def status(self) -> CameraStatus:
        if self._is_open and self._is_preparing:
            return CameraStatus(CameraState.STARTING, "preparing its room")
        return CameraStatus(CameraState.STREAMING)

    @property
    def counters(self) -> CameraCounters:
        return self._counters

    def _check_open(self) -> None:
        if not self._is_open:
            raise CameraLostError("synthetic camera: not open; use `with`, or call open()")

    def _due_s(self, seq: int) -> float:
        """When a frame is complete, in seconds after the stamp of the first one."""
        timing = self._config.timing
        latency_s = timing.readout_s / 2 + max(timing.skew_s, 0.0)
        return seq / self._config.rate_hz + latency_s

    def _count_delivered(self, seq: int) -> None:
        self._counters += CameraCounters(delivered=1, dropped=seq - self._next_seq)
        self._next_seq = seq + 1

    def _make_frame(
        self, seq: int, stamp_s: float, receive_time_s: float, images: RenderedImages
    ) -> RgbdFrame:
        """Make frame `seq`; its times are in seconds on the clock of the camera."""
        return RgbdFrame(
            seq=seq,
            stamp_s=stamp_s,
            receive_time_s=receive_time_s,
            color_bgr=images.color_bgr,
            depth_raw=images.depth_raw,
            depth_factor=self._config.depth_factor,
            camera=self._config.camera,
            skew_s=self._config.timing.skew_s,
            gravity_m_s2=self._accelerometer.gravity_m_s2(seq),
            accelerometer=(AccelerometerReading(stamp_s, self._accelerometer.reading_m_s2(seq)),),
            readout_s=self._config.timing.readout_s,
        )
