"""Frames that a separate process renders ahead of the reader."""

import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import CameraState, FrameTimeout, PlaybackMode, RgbdFrame
from drivers.core import CameraLostError
from drivers.core.process.worker_spec import WorkerSpec
from drivers.synthetic import frame_provider
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.rendered_sequence import create_sequence, files_for_config
from drivers.synthetic.sensors import RenderedImages
from tests.drivers.fake_host import FakeHost
from tests.drivers.synthetic import idle_renderer
from tests.drivers.synthetic.cached_cameras import RendererFactory, read_frames
from tests.drivers.synthetic.conftest import FAULTY
from tests.resource_leaks import child_pids
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

START_S = 60.0


@contextmanager
def opened(camera: SyntheticCamera) -> Iterator[RgbdFrame]:
    """Open a camera and yield its first frame."""
    with camera:
        yield camera.read(START_S)


def pixels(frames: Sequence[RgbdFrame | RenderedImages]) -> list[bytes]:
    return [frame.color_bgr.tobytes() + frame.depth_raw.tobytes() for frame in frames]


def test_the_frames_are_those_of_any_renderer_and_no_process_is_left(
    tmp_path: Path, shared_renderer: RendererFactory
) -> None:
    """The one here renders them from the last to the first."""
    renderer = shared_renderer(FAULTY)
    rendered = [renderer.render(index) for index in reversed(range(FAULTY.frame_count))][::-1]
    camera = SyntheticCamera(FAULTY, tmp_path, threads=1)
    with opened(camera) as first:
        assert pixels([first, *read_frames(camera)]) == pixels(rendered)
    assert child_pids() == []
    with SyntheticCamera(FAULTY, tmp_path) as again:
        assert child_pids() == []  # no frame is missing, so no process runs
        assert pixels(read_frames(again)) == pixels(rendered)


def test_a_live_camera_prepares_its_room_and_goes_on_after_its_process(tmp_path: Path) -> None:
    looped = replace(FAULTY, loop=True)
    with SyntheticCamera(looped, tmp_path, PlaybackMode.REALTIME) as camera:
        with pytest.raises(FrameTimeout):
            camera.read(0.0)
        assert str(camera.status) == "starting: preparing its room"
        assert camera.read(START_S).seq == 0
        assert camera.status.state is CameraState.STREAMING
        wait_until(lambda: camera.read(START_S) and not child_pids())
        assert camera.read(START_S).seq > 0


@pytest.mark.parametrize(("due", "seq", "dropped"), [(4, 3, 2), (3, 3, 2), (2, 1, 0)])
def test_a_live_reader_gets_the_newest_frame_that_is_rendered_and_the_rest_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, due: int, seq: int, dropped: int
) -> None:
    """Frames 0, 1 and 3 are rendered; no others ever are."""
    monkeypatch.setattr(frame_provider, "RENDERER", WorkerSpec(idle_renderer.__name__, "idle"))
    host, black = (
        FakeHost(),
        RenderedImages(np.zeros((96, 128, 3), np.uint8), np.zeros((96, 128), np.uint16)),
    )
    sequence = create_sequence(files_for_config(FAULTY, tmp_path))
    for index in (0, 1, 3):
        sequence.write(index, black)
    with SyntheticCamera(FAULTY, tmp_path, PlaybackMode.REALTIME, host=host.clock) as camera:
        assert camera.read(1.0).seq == 0
        host.sleep(due / FAULTY.rate_hz)
        assert camera.read(1.0).seq == seq
        assert camera.counters.dropped == dropped


def test_a_renderer_that_is_killed_is_reported_keeps_its_frames_and_is_started_again(
    tmp_path: Path,
) -> None:
    long = replace(FAULTY, duration_s=60.0)
    camera = SyntheticCamera(long, tmp_path)
    with opened(camera):
        (renderer,) = child_pids()
        os.kill(renderer, signal.SIGKILL)
        with pytest.raises(CameraLostError, match="the renderer crashed"):
            deque(iter(lambda: camera.read(START_S), None), maxlen=0)
    sequence = create_sequence(files_for_config(long, tmp_path))
    assert 0 < sequence.missing_frames().size < 1800
    assert sequence.read(0) is not None
    sequence.close()
    with opened(camera) as first:
        assert first.seq == 0
