"""Frames of the virtual Kinect from rendered images."""

from drivers.camera import AccelerometerReading, RgbdFrame
from drivers.synthetic.accelerometer import SyntheticAccelerometer
from drivers.synthetic.camera_motion import CameraMotion
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.sensors import RenderedImages


class FrameMaker:
    """Makes the frames of one camera."""

    def __init__(self, config: SyntheticConfig, motion: CameraMotion) -> None:
        self._config = config
        self._accelerometer = SyntheticAccelerometer(config, motion)

    def make(
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
