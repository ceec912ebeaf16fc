"""An .oni recording as a camera."""

from pathlib import Path

from drivers.camera import CameraCounters, Clock, PlaybackMode, RgbdCamera, RgbdFrame, SensorConfig
from drivers.core.errors import CameraError
from drivers.openni2.library import OpenNI2
from drivers.openni2.oni_playback import OniPlayback
from drivers.openni2.rectify import CalibrationFile


class OniCamera(RgbdCamera):
    """Plays a recording through libOpenNI2, on the reader's thread (see `drivers.openni2.library`).

    Stamps are the recording's own (usually microseconds since its start). Color and depth are
    paired by nearest stamp over the whole file, so both playback modes deliver the same frames.
    For the rule of registration see `drivers.openni2.rectify`. Of the settings only `mirror` is
    used; a mirrored recording is mirrored back unless it is set. A pair that cannot be read is
    skipped, counted and logged.
    """

    clock = Clock.RECORDED

    def __init__(
        self,
        path: Path,
        camera_file: Path | None = None,
        playback_mode: PlaybackMode = PlaybackMode.LOCKSTEP,
        settings: SensorConfig | None = None,
    ) -> None:
        self.name = f"openni2:{path}"
        self._path, self._camera_file, self._playback_mode = path, camera_file, playback_mode
        self._mirror = (settings or SensorConfig()).mirror
        self._openni2: OpenNI2 | None = None
        self._playback: OniPlayback | None = None
        self._is_open = False

    def open(self) -> None:
        """Check the file and start playback.

        Raises:
            InputError: If the file cannot be used.
        """
        self.close()
        calibration_file = CalibrationFile.read(self._camera_file)
        self._openni2 = self._openni2 or OpenNI2()
        self._playback = OniPlayback(
            self._openni2,
            self._path,
            calibration_file,
            self._playback_mode,
            self._mirror,
            self.counters,
        )
        self._is_open = True

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame, see `RgbdCamera.read`."""
        if self._playback is None or not self._is_open:
            raise CameraError(f"{self.name}: the recording is not open; open it first")
        return self._playback.read(timeout_s)

    def close(self) -> None:
        """Stop playback. The counters remain valid."""
        self._is_open = False
        if self._playback is not None:
            self._playback.close()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`."""
        return self._playback.counters if self._playback else CameraCounters()

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; "" before `open`."""
        return self._playback.rectifier.intrinsics_source if self._playback else ""

    @property
    def frame_count(self) -> int | None:
        """The number of pairs of color and depth; None before `open`."""
        return len(self._playback.index.pairs) if self._playback else None

    @property
    def unpaired(self) -> int | None:
        """The number of images without a partner within 20 ms; None before `open`."""
        return self._playback.index.unpaired if self._playback else None
