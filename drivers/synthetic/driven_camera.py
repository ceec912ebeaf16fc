"""A virtual Kinect on a base that is sent velocities: frames are rendered while it drives."""

import math
import os
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.camera import Clock, FrameTimeout, RgbdFrame
from drivers.core import CameraLostError, InputError
from drivers.core.geometry import Array, Trajectory
from drivers.core.memory import release_memory
from drivers.core.queues import DropOldestQueue
from drivers.pacing import RealtimePacer
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.driven_motion import DrivenMotion
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.synthetic.virtual_camera import VirtualCamera

# The renderer looks this often whether the camera is closed.
TICK_S = 0.2
# A frame is rendered in a tenth of it; the room takes longer, and its thread may go on.
MAX_CLOSE_S = 1.0
MAX_TRUE_POSES = 100_000


@dataclass(frozen=True)
class _DrivenFrame:
    """A frame and its true T_world_camera (4, 4)."""

    frame: RgbdFrame
    T_world_camera: Array


class DrivenCamera(VirtualCamera):
    """A live camera in a virtual room, on a base that `set_velocity` drives.

    A thread renders each frame when it is due, where the base is then. Frames that are due while it
    renders are dropped, as are those that are not read in time. Closing the camera ends the frames
    and not the drive. Nothing is in the base's way: it drives through walls.

    Args:
        config: The room, the sensor and the camera's mount.
    """

    clock = Clock.MONOTONIC

    def __init__(self, config: SyntheticConfig) -> None:
        self._motion = DrivenMotion(config)
        super().__init__(config, self._motion)
        self._pacer = RealtimePacer(self._due_s, sys.maxsize)
        self._renderer: Renderer | None = None
        self._thread: threading.Thread | None = None
        self._opened, self._stop = threading.Event(), threading.Event()
        self._queue: DropOldestQueue[_DrivenFrame] = DropOldestQueue(1)
        self._truth: deque[tuple[float, Array]] = deque(maxlen=MAX_TRUE_POSES)

    def prepare(self) -> None:
        """Start painting the room."""
        if self._thread is None:
            self._opened, self._stop = threading.Event(), threading.Event()
            self._queue = DropOldestQueue(1)
            shared = self._queue, self._opened, self._stop
            self._thread = threading.Thread(
                target=self._render, args=shared, name="renderer", daemon=True
            )
            self._thread.start()

    def open(self) -> None:
        """See `RgbdCamera`. Until the room is painted, `status` is OPENING."""
        self.prepare()
        self._opened.set()
        self._is_open = True

    def read(self, timeout_s: float) -> RgbdFrame:
        self._check_open()
        try:
            newest = self._queue.get(timeout_s)
        except TimeoutError:
            raise FrameTimeout from None
        frame = newest.frame
        self._truth.append((frame.stamp_s, newest.T_world_camera))
        self._count_delivered(frame.seq)
        return frame

    def close(self) -> None:
        self._is_open = False
        thread, self._thread = self._thread, None
        if thread is not None:
            self._stop.set()
            self._opened.set()
            thread.join(MAX_CLOSE_S)

    @property
    def can_drive(self) -> bool:
        return True

    def set_velocity(self, forward_m_s: float, yaw_rad_s: float) -> None:
        if not (math.isfinite(forward_m_s) and math.isfinite(yaw_rad_s)):
            raise InputError(f"velocity {forward_m_s} m/s, {yaw_rad_s} rad/s: it is not finite")
        now_s = time.monotonic() - self._pacer.start_s
        if now_s >= 0.0:  # before its first frame it stands still
            self._motion.drive(now_s, forward_m_s, yaw_rad_s)

    @property
    def _is_preparing(self) -> bool:
        return self._pacer.start_s == math.inf

    @property
    def ground_truth(self) -> Trajectory | None:
        """Exact T_world_camera of the frames that were read so far; None before the first one."""
        truth = tuple(self._truth)
        if not truth:
            return None
        stamps_s, poses = zip(*truth, strict=True)
        return Trajectory(np.array(stamps_s), np.array(poses))

    def _render(
        self,
        queue: DropOldestQueue[_DrivenFrame],
        opened: threading.Event,
        stop: threading.Event,
    ) -> None:
        """Paint the room once, then render until the camera is closed, in a thread."""
        try:
            if self._renderer is None:
                self._renderer = self._make_renderer()
            opened.wait()  # its clock begins then
            self._render_frames(self._renderer, queue, stop)
        except Exception as error:  # the reader raises it
            queue.abort(CameraLostError(f"synthetic camera: {error}"))

    def _make_renderer(self) -> Renderer:
        room = RoomModel.build(self._config, self._motion, os.cpu_count() or 1)
        renderer = Renderer(self._config, self._motion, room)
        renderer.render(0)  # compiles all kernels
        release_memory()
        return renderer

    def _render_frames(
        self, renderer: Renderer, queue: DropOldestQueue[_DrivenFrame], stop: threading.Event
    ) -> None:
        seq = self._next_seq
        while not stop.is_set():
            try:
                seq = self._pacer.wait_until_due(seq, TICK_S)
            except FrameTimeout:
                continue
            queue.put(self._render_frame(seq, renderer))
            seq += 1

    def _render_frame(self, seq: int, renderer: Renderer) -> _DrivenFrame:
        time_s = seq / self._config.rate_hz
        stamp_s = round(self._pacer.start_s + time_s, 6)
        images = renderer.render(seq)
        frame = self._make_frame(seq, stamp_s, self._pacer.receive_time_s(seq), images)
        (T_world_camera,) = self._motion.poses(np.array([time_s]))
        return _DrivenFrame(frame, T_world_camera)
