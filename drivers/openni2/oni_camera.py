"""An .oni recording as a camera."""

from pathlib import Path

from drivers.camera import CameraCounters, Clock, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core.errors import CameraError
from drivers.openni2.library import OpenNI2
from drivers.openni2.oni_playback import OniPlayback
from drivers.openni2.rectify import CalibrationFile
from drivers.sensor_config import SensorConfig


class OniCamera(RgbdCamera):
    """Plays a recording through libOpenNI2, on the reader's thread (see `drivers.openni2.library`).

    Stamps are the recording's own (microseconds since it began, as a rule). Color and depth are
    paired by nearest stamp over the whole file, so both paces deliver the same frames.
    `drivers.openni2.rectify` has the rule by which depth counts as registered. A recording that
    was taken mirrored is turned back (`settings.mirror` asks for it mirrored); the other settings
    have no meaning for it. A pair that cannot be read is skipped, counted and reported in the log.
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
        """Check the file and start to play. Raises InputError for a file without use."""
        self.close()
        choice = CalibrationFile.read(self._camera_file)
        self._openni2 = self._openni2 or OpenNI2()
        self._playback = OniPlayback(
            self._openni2, self._path, choice, self._playback_mode, self._mirror
        )
        self._is_open = True

    def read(self, timeout_s: float) -> RgbdFrame:
        """The next frame at this pace, as the contract says."""
        if self._playback is None or not self._is_open:
            raise CameraError(f"{self.name}: the recording is not open")
        return self._playback.read(timeout_s)

    def close(self) -> None:
        """Stop playing; what has been counted can still be asked for."""
        self._is_open = False
        if self._playback is not None:
            self._playback.close()

    @property
    def counters(self) -> CameraCounters:
        """Totals since `open`."""
        return self._playback.counters if self._playback else CameraCounters()

    @property
    def intrinsics_source(self) -> str:
        """See `RgbdCamera`; "" before `open`."""
        return self._playback.rectifier.intrinsics_source if self._playback else ""

    @property
    def frame_count(self) -> int | None:
        """Pairs of color and depth; None before `open`."""
        return len(self._playback.index.pairs) if self._playback else None

    @property
    def unpaired(self) -> int | None:
        """Images without a partner within 20 ms; None before `open`."""
        return self._playback.index.unpaired if self._playback else None
