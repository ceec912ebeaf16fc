"""Cameras for a process of their own: one does as a file says, the other plays a short sequence."""

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    EndOfStream,
    PinholeCamera,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core import CameraLostError
from tests.drivers.subprocess_camera.scripted_actions import ACTIONS, pause
from tests.resource_leaks import count_open_files

SMALL_SIZE = (64, 48)
LOST_PACKETS = 3


def make_pattern_frame(seq: int, stamp_s: float, size: tuple[int, int] = SMALL_SIZE) -> RgbdFrame:
    """A frame whose every pixel says which frame it is of."""
    width, height = size
    return RgbdFrame(
        seq=seq,
        stamp_s=stamp_s,
        receive_time_s=time.monotonic(),
        color_bgr=np.full((height, width, 3), seq % 251, np.uint8),
        depth_raw=np.full((height, width), seq, np.uint16),
        depth_factor=1000.0,
        camera=PinholeCamera(width, height, float(width), float(width), width / 2, height / 2),
    )


def is_intact(frame: RgbdFrame) -> bool:
    """Whether all pixels are of one frame."""
    seq = int(frame.depth_raw[0, 0])
    return bool(np.all(frame.depth_raw == seq) and np.all(frame.color_bgr == seq % 251))


class FileScriptedCamera(RgbdCamera):
    """A live camera that does what a file says; without words in it, it works.

    A frame's `device_stamp_s` is how many files its process has open, its `lost_packets` the
    process's number.
    """

    name = "scripted"
    clock = Clock.MONOTONIC

    def __init__(self, script: Path, period_s: float = 0.002, size: tuple[int, int] = SMALL_SIZE):
        self._script, self._period_s, self._size = script, period_s, size
        self._seq = 0
        self._counters = CameraCounters()

    def open(self) -> None:
        self._run_script("open")
        self._seq = 0
        self._counters += CameraCounters(lost_packets=LOST_PACKETS)

    def read(self, timeout_s: float) -> RgbdFrame:
        pause(self._period_s)
        self._run_script("read")
        frame = make_pattern_frame(self._seq, time.monotonic(), self._size)
        self._seq += 1
        return replace(frame, device_stamp_s=float(count_open_files()), lost_packets=os.getpid())

    def close(self) -> None:
        """Close, or whatever it is told to do in close."""
        if self._script.read_text().endswith(" in close"):
            self._run_script("close")

    @property
    def counters(self) -> CameraCounters:
        return self._counters

    def wait_for_reconnect(self, timeout_s: float) -> None:
        """Notice at once that it is back."""
        pause(min(timeout_s, 0.005))

    def _run_script(self, where: str) -> None:
        word, _, place = self._script.read_text().partition(" in ")
        if word and place in ("", where):
            ACTIONS[word]()


class WarningCamera(FileScriptedCamera):
    """Has something to say of its frames while it sends them, and why it sends none."""

    @property
    def status(self) -> CameraStatus:
        return CameraStatus(CameraState.STREAMING, "losing strings: 3 of 5 frames torn")


def opening_marker(script: Path) -> Path:
    """The file that `OpeningMarkerCamera` makes as soon as it begins to open."""
    return script.with_suffix(".opening")


class OpeningMarkerCamera(FileScriptedCamera):
    """Leaves a mark beside its script as soon as it begins to open."""

    def open(self) -> None:
        opening_marker(self._script).touch()
        super().open()


class SingleFrameCamera(FileScriptedCamera):
    """Sends one frame each time that it is plugged in."""

    def read(self, timeout_s: float) -> RgbdFrame:
        if self._seq:
            raise CameraLostError("scripted: unplugged")
        return super().read(timeout_s)


class RecordedCamera(FileScriptedCamera):
    """A recording of so many frames, 30 a second, as fast as they are read, or not as fast."""

    name = "sequence"
    clock = Clock.RECORDED

    def __init__(self, script: Path, count: int, period_s: float = 0.0) -> None:
        super().__init__(script, period_s)
        self._count = count

    def read(self, timeout_s: float) -> RgbdFrame:
        if self._seq == self._count:
            raise EndOfStream
        seq = super().read(timeout_s).seq
        return make_pattern_frame(seq, 100.0 + seq / 30.0)

    @property
    def frame_count(self) -> int | None:
        return self._count

    @property
    def intrinsics_source(self) -> str:
        return "factory"
