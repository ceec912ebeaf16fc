"""The virtual Kinect as a camera: it delivers frames like a real one while they are rendered."""

import math
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np

from drivers.camera import (
    Clock,
    EndOfStream,
    FrameTimeout,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraError, CameraLostError, CameraNotFoundError, InputError
from drivers.core.geometry import Trajectory
from drivers.faulty_camera import FaultKind, FaultyCamera
from drivers.pacing import HOST_CLOCK, HostClock, make_pacer
from drivers.synthetic.config import MotionKind, SyntheticConfig
from drivers.synthetic.driven_camera import DrivenCamera
from drivers.synthetic.frame_provider import FrameProvider
from drivers.synthetic.motions import make_motion
from drivers.synthetic.room import ROOM_HEIGHT_M
from drivers.synthetic.virtual_camera import VirtualCamera

FIRST_STAMP_S = 1000.0  # in lockstep

# A live reader checks this often which frame is due while none is rendered.
POLL_PERIOD_S = 0.02


class SyntheticCamera(VirtualCamera):
    """A camera in a virtual room, see `SyntheticConfig`. Stamps are exact to the microsecond.

    In lockstep, stamps start at a fixed value: two runs give the same bytes. Live, frames that are
    not rendered in time are dropped. Of the faults it has only those that unplug it; see
    `make_synthetic_camera`.

    Args:
        config: The room, the motion and the sensor.
        folder: A separate process renders ahead and stores the frames here.
        playback_mode: Lockstep delivers every frame; realtime drops late ones.
        threads: Rendering threads; 0 for one per core.
        host: Clock and sleep function; tests replace it.

    Raises:
        InputError: The track cannot be read, or there are too many frames to store.
    """

    def __init__(
        self,
        config: SyntheticConfig,
        folder: Path,
        playback_mode: PlaybackMode = PlaybackMode.LOCKSTEP,
        threads: int = 0,
        host: HostClock = HOST_CLOCK,
    ) -> None:
        self._motion = make_motion(config, ROOM_HEIGHT_M)
        super().__init__(config, self._motion)
        self._host = host
        self._is_live = playback_mode is PlaybackMode.REALTIME
        self.clock = Clock.MONOTONIC if self._is_live else Clock.RECORDED
        count = sys.maxsize if config.loop else config.frame_count
        self._pacer = make_pacer(playback_mode, self._due_s, count, host)
        self._last_seq = count - 1
        rate_hz = config.rate_hz if self._is_live else 0.0
        self._frame_provider = FrameProvider(config, folder, rate_hz, threads)
        self._unplugs = [each for each in config.faults if each.kind is FaultKind.UNPLUGGED]
        self._pending_unplugs = list(self._unplugs)
        self._is_disconnected = self._has_started = False
        self._reconnect_time_s = 0.0

    def prepare(self) -> None:
        """Start painting the room."""
        with suppress(CameraError, InputError):
            self._frame_provider.start()

    def open(self) -> None:
        """See `RgbdCamera`. Until the room is painted, `status` is OPENING."""
        if self._is_disconnected and self._host.now_s() < self._reconnect_time_s:
            raise CameraNotFoundError("synthetic camera: unplugged; it comes back by itself")
        self._frame_provider.start()
        self._has_started = False
        if self._is_disconnected:
            self._next_seq = self._pacer.newest_due(self._next_seq - 1) + 1
        else:
            self._pacer.rewind()
            self._next_seq = 0
            self._pending_unplugs = list(self._unplugs)
        self._is_open, self._is_disconnected = True, False

    def read(self, timeout_s: float) -> RgbdFrame:
        self._check_open()
        self._wait_for_start(timeout_s)
        deadline_s = self._host.now_s() + timeout_s
        while True:
            if self._next_seq > self._last_seq:
                raise EndOfStream
            due = self._pacer.wait_until_due(self._next_seq, self._remaining_s(deadline_s))
            self._raise_if_unplugged(due)
            seq = self._frame_provider.wait_for_newest(
                self._next_seq, due, min(POLL_PERIOD_S, self._remaining_s(deadline_s))
            )
            if seq is None:
                if self._remaining_s(deadline_s) <= 0.0:
                    raise FrameTimeout
                continue
            self._count_delivered(seq)
            images = self._frame_provider.read(seq)
            receive_time_s = self._pacer.receive_time_s(seq)
            return self._make_frame(seq, self._stamp_s(seq), receive_time_s, images)

    def close(self) -> None:
        self._is_open = False
        self._frame_provider.close()

    @property
    def _is_preparing(self) -> bool:
        return not self._has_started

    @property
    def frame_count(self) -> int | None:
        """Number of frames of the whole run; None in a loop."""
        return None if self._config.loop else self._config.frame_count

    @property
    def ground_truth(self) -> Trajectory | None:
        """Exact T_world_camera at every frame's true stamp, in the room's frame; None in a loop.

        In realtime mode the stamps, and so the ground truth, are known after the first `read`.
        """
        if self._config.loop or (self._is_live and self._pacer.start_s == math.inf):
            return None
        seqs = np.arange(self._config.frame_count)
        stamps_s = np.array([self._stamp_s(int(seq)) for seq in seqs])
        return Trajectory(stamps_s, self._motion.poses(seqs / self._config.rate_hz))

    def _wait_for_start(self, timeout_s: float) -> None:
        """Wait until the first frame is rendered. Raises FrameTimeout."""
        if not self._has_started:
            if not self._frame_provider.wait_until_started(timeout_s):
                raise FrameTimeout
            self._has_started = True

    def _remaining_s(self, deadline_s: float) -> float:
        return max(0.0, deadline_s - self._host.now_s())

    def _raise_if_unplugged(self, seq: int) -> None:
        """Raise CameraLostError if a fault unplugs the camera at a frame up to `seq`."""
        due = [fault for fault in self._pending_unplugs if self._next_seq <= fault.first <= seq]
        if not due:
            return
        fault = due[0]
        self._pending_unplugs.remove(fault)
        self._reconnect_time_s = self._host.now_s() + fault.seconds
        self._next_seq = fault.first + round(fault.seconds * self._config.rate_hz)
        self._is_open, self._is_disconnected = False, True
        raise CameraLostError("synthetic camera: unplugged by a configured fault; open it again")

    def _stamp_s(self, seq: int) -> float:
        """Stamp of a frame in whole microseconds."""
        start_s = self._pacer.start_s if self._is_live else FIRST_STAMP_S
        return round(start_s + seq / self._config.rate_hz, 6)


def make_synthetic_camera(
    config: SyntheticConfig,
    folder: Path,
    playback_mode: PlaybackMode = PlaybackMode.LOCKSTEP,
    threads: int = 0,
    host: HostClock = HOST_CLOCK,
) -> RgbdCamera:
    """Make a virtual Kinect with all faults of its configuration; see `SyntheticCamera`.

    On a base that is driven it is a `DrivenCamera`, which is live only. Raises InputError.
    """
    camera: RgbdCamera
    if config.motion is not MotionKind.DRIVEN:
        camera = SyntheticCamera(config, folder, playback_mode, threads, host)
    elif playback_mode is PlaybackMode.REALTIME:
        camera = DrivenCamera(config)
    else:
        raise InputError(
            'synthetic camera: motion "driven" is for `kinect-vo run` at its own pace: '
            "nobody drives a replay"
        )
    return FaultyCamera(camera, config.faults, config.seed) if config.faults else camera
