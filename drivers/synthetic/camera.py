"""The virtual Kinect as a camera: played like a real one, while it is rendered."""

import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.camera import (
    CameraCounters,
    CameraState,
    Condition,
    EndOfStream,
    NoFrameYet,
    Pace,
    RgbdCamera,
    RgbdFrame,
)
from drivers.errors import CameraError, CameraLostError, CameraNotFoundError, InputError
from drivers.gravity import STANDARD_GRAVITY_M_S2, Vector
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import FaultKind, FaultySource
from drivers.synthetic.motion import make_path
from drivers.synthetic.pacing import HostClock, make_pacer
from drivers.synthetic.rendering import BackgroundRendering, DirectRendering, Rendering
from drivers.synthetic.scene import ROOM_HEIGHT_M
from drivers.trajectory import StampedPoses

# How often a live reader looks which frame is due, while none is rendered.
TICK_S = 0.02


@dataclass(frozen=True)
class Preparation:
    """How frames are made: rendered ahead by a process of its own and kept in `cache_dir`.

    Without a `cache_dir` each frame is rendered when it is read. 0 threads: one a core.
    """

    cache_dir: Path | None = None
    threads: int = 0


class SyntheticCamera(RgbdCamera):
    """A camera in a virtual room, see `SyntheticConfig`. Stamps are exact to the microsecond.

    In lockstep, stamps start at a fixed value: two runs give the same bytes. Live, frames that are
    not rendered in time are dropped.
    """

    def __init__(
        self,
        config: SyntheticConfig,
        pace: Pace = Pace.LOCKSTEP,
        preparation: Preparation = Preparation(),
        host: HostClock = HostClock(),  # noqa: B008 (frozen)
    ) -> None:
        """Raises InputError if `config` cannot be used: its track, or too many frames to keep."""
        self.name = "synthetic"
        self._config = config
        self._host = host
        latency_s = config.timing.readout_s / 2 + max(config.timing.skew_s, 0.0)
        self._pacer = make_pacer(pace, config.rate_hz, latency_s, host)
        self.clock = self._pacer.clock
        self._path = make_path(config, ROOM_HEIGHT_M)
        self._last_seq = sys.maxsize if config.loop else config.frame_count - 1
        self._rendering = _rendering(config, pace, preparation)
        self._frames = FaultySource(self._rendering.images, config.faults, config.seed)
        self._unplugs = [f for f in config.faults if f.kind is FaultKind.UNPLUGGED]
        self._open = self._lost = self._has_started = False
        self._next_seq = 0
        self._back_at_s = 0.0
        self._counters = CameraCounters()

    def prepare(self) -> None:
        """Paint the room, where that is done in the background."""
        with suppress(CameraError, InputError):
            self._rendering.prepare()

    def open(self) -> None:
        """See `RgbdCamera`. Until the room is painted, `condition` says that it is opening."""
        if self._lost and self._host.now_s() < self._back_at_s:
            raise CameraNotFoundError("synthetic camera: unplugged; it comes back by itself")
        self._rendering.start()
        self._has_started = False
        if self._lost:
            self._next_seq = self._pacer.resume(self._next_seq)
        else:
            self._pacer.rewind()
            self._next_seq = 0
            self._unplugs = [f for f in self._config.faults if f.kind is FaultKind.UNPLUGGED]
        self._open, self._lost = True, False
        self._counters = CameraCounters()

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`."""
        if not self._open:
            raise CameraLostError("synthetic camera: not open; open it again")
        self._wait_for_start(timeout_s)
        deadline_s = self._host.now_s() + timeout_s
        while True:
            if self._next_seq > self._last_seq:
                raise EndOfStream
            due = self._pacer.take(self._next_seq, self._last_seq, self._left_s(deadline_s))
            self._unplug_by(due)
            seq = self._rendering.newest(self._next_seq, due, min(TICK_S, self._left_s(deadline_s)))
            if seq is None:
                if self._left_s(deadline_s) <= 0.0:
                    raise NoFrameYet
                continue
            while seq > self._next_seq and self._frames.strikes(FaultKind.DROPPED, seq):
                seq -= 1
            passed_over, self._next_seq = seq - self._next_seq, seq + 1
            self._count(dropped=passed_over)
            if not self._frames.strikes(FaultKind.DROPPED, seq):
                self._count(delivered=1)
                return self._frame(seq, self._frames)
            self._count(skipped=1)

    def close(self) -> None:
        """See `RgbdCamera`."""
        self._open = False
        self._rendering.close()

    @property
    def condition(self) -> Condition:
        """See `RgbdCamera`."""
        if self._open and not self._has_started:
            return Condition(CameraState.OPENING, "preparing its room")
        return Condition(CameraState.STREAMING)

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; `skipped` counts the frames dropped on request."""
        return self._counters

    @property
    def frame_count(self) -> int | None:
        """Frames of the whole run; None in a loop."""
        return None if self._config.loop else self._config.frame_count

    @property
    def ground_truth(self) -> StampedPoses | None:
        """The exact poses at every frame's true stamp, in the room's frame; None in a loop.

        With a live pace the stamps, and so the truth, are known from the first `read` on.
        """
        if self._config.loop or not self._pacer.is_running:
            return None
        seqs = np.arange(self._config.frame_count)
        stamps_s = np.array([self._pacer.stamp_s(int(seq)) for seq in seqs])
        return StampedPoses(stamps_s, self._path.poses(seqs / self._config.rate_hz))

    def _wait_for_start(self, timeout_s: float) -> None:
        """The camera is open once its first frame is rendered. Raises NoFrameYet."""
        if not self._has_started:
            if not self._rendering.wait_until_started(timeout_s):
                raise NoFrameYet
            self._has_started = True

    def _left_s(self, deadline_s: float) -> float:
        return max(0.0, deadline_s - self._host.now_s())

    def _unplug_by(self, seq: int) -> None:
        """Raise CameraLostError if the camera is to be unplugged at a frame up to `seq`."""
        due = [fault for fault in self._unplugs if self._next_seq <= fault.first <= seq]
        if not due:
            return
        fault = due[0]
        self._unplugs.remove(fault)
        self._back_at_s = self._host.now_s() + fault.seconds
        self._next_seq = fault.first + round(fault.seconds * self._config.rate_hz)
        self._open, self._lost = False, True
        raise CameraLostError("synthetic camera: unplugged on request; open it again")

    def _frame(self, seq: int, frames: FaultySource) -> RgbdFrame:
        images = frames.images(seq)
        stamped_as, off_s = frames.stamped_as(seq)
        return RgbdFrame(
            seq=seq,
            stamp_s=round(self._pacer.stamp_s(stamped_as) + off_s, 6),
            arrival_s=self._pacer.arrival_s(seq),
            colour_bgr=images.colour,
            depth_raw=images.depth,
            depth_factor=self._config.depth_factor,
            camera=self._config.camera,
            skew_s=self._config.timing.skew_s,
            gravity_m_s2=self._gravity(seq),
            readout_s=self._config.timing.readout_s,
        )

    def _gravity(self, seq: int) -> Vector:
        """What an accelerometer without fault would tell; the room's z is up."""
        instant_s = np.array([seq / self._config.rate_hz])
        x, y, z = (-STANDARD_GRAVITY_M_S2 * self._path.poses(instant_s)[0, 2, :3]).tolist()
        return (x, y, z)

    def _count(self, delivered: int = 0, dropped: int = 0, skipped: int = 0) -> None:
        now = self._counters
        self._counters = replace(
            now,
            delivered=now.delivered + delivered,
            dropped=now.dropped + dropped,
            skipped=now.skipped + skipped,
        )


def _rendering(config: SyntheticConfig, pace: Pace, preparation: Preparation) -> Rendering:
    if preparation.cache_dir is None:
        return DirectRendering(config, preparation.threads)
    rate_hz = config.rate_hz if pace is Pace.REALTIME else 0.0
    return BackgroundRendering(config, preparation.cache_dir, rate_hz, preparation.threads)
