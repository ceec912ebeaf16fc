"""The virtual Kinect as a camera: rendered once, then played like a real one."""

import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.camera import CameraCounters, EndOfStream, Pace, RgbdCamera, RgbdFrame
from drivers.errors import CameraLostError, CameraNotFoundError
from drivers.gravity import STANDARD_GRAVITY_M_S2, Vector
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import FaultKind, FaultySource, Source
from drivers.synthetic.film import Progress, film_source, load_or_render, silent
from drivers.synthetic.motion import make_path
from drivers.synthetic.pacing import HostClock, make_pacer
from drivers.synthetic.render import make_renderer
from drivers.synthetic.scene import ROOM_HEIGHT_M
from drivers.trajectory import StampedPoses


@dataclass(frozen=True)
class Preparation:
    """How frames are made: `preload` renders all of them in `open`, which then plays from memory.

    With a `cache_dir` they are kept there and rendered only once. 0 threads: one a core.
    """

    preload: bool = True
    cache_dir: Path | None = None
    progress: Progress = silent
    threads: int = 0


class SyntheticCamera(RgbdCamera):
    """A camera in a virtual room, see `SyntheticConfig`. Stamps are exact to the microsecond.

    In lockstep, stamps start at a fixed value: two runs give the same bytes.
    """

    def __init__(
        self,
        config: SyntheticConfig,
        pace: Pace = Pace.LOCKSTEP,
        preparation: Preparation = Preparation(),
        host: HostClock = HostClock(),  # noqa: B008 (frozen)
    ) -> None:
        """Raises InputError if the track of `config` cannot be used."""
        self.name = "synthetic"
        self._config = config
        self._preparation = preparation
        self._host = host
        latency_s = config.timing.readout_s / 2 + max(config.timing.skew_s, 0.0)
        self._pacer = make_pacer(pace, config.rate_hz, latency_s, host)
        self.clock = self._pacer.clock
        self._path = make_path(config, ROOM_HEIGHT_M)
        self._last_seq = sys.maxsize if config.loop else config.frame_count - 1
        self._frames: FaultySource | None = None
        self._unplugs = [f for f in config.faults if f.kind is FaultKind.UNPLUGGED]
        self._open = self._lost = False
        self._next_seq = 0
        self._back_at_s = 0.0
        self._counters = CameraCounters()

    def open(self) -> None:
        """See `RgbdCamera`. The first time, frames are rendered or read from the cache."""
        if self._lost and self._host.now_s() < self._back_at_s:
            raise CameraNotFoundError("synthetic camera: unplugged; it comes back by itself")
        if self._frames is None:
            self._frames = FaultySource(self._prepare(), self._config.faults, self._config.seed)
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
        if not self._open or self._frames is None:
            raise CameraLostError("synthetic camera: not open; open it again")
        deadline_s = self._host.now_s() + timeout_s
        while True:
            if self._next_seq > self._last_seq:
                raise EndOfStream
            remaining_s = max(0.0, deadline_s - self._host.now_s())
            seq = self._pacer.take(self._next_seq, self._last_seq, remaining_s)
            self._unplug_by(seq)
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

    def _prepare(self) -> Source:
        config, way = self._config, self._preparation
        threads = way.threads or os.cpu_count() or 1
        if way.preload:
            return film_source(load_or_render(config, way.cache_dir, way.progress, threads))
        renderer = make_renderer(config, threads)
        return lambda seq: renderer.render(seq % config.frame_count)

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
