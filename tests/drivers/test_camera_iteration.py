"""A loop over the frames of a camera."""

from itertools import islice
from pathlib import Path

import pytest

from drivers import CameraError, CameraLostError
from drivers.camera import CameraState, CameraStatus
from drivers.registry import open_camera
from tests.conftest import FRAMES
from tests.vo_service.fakes import ScriptedCamera, make_frame

ABSENT = CameraStatus(CameraState.ABSENT, "plug it in")


def test_a_loop_ends_after_the_last_frame_of_a_recording(recording: Path) -> None:
    with open_camera(f"tum:{recording}") as camera:
        assert [frame.seq for frame in camera] == list(range(FRAMES))
        assert list(camera) == []


def test_an_interrupted_loop_continues_with_the_next_frame(recording: Path) -> None:
    with open_camera(f"tum:{recording}") as camera:
        assert [frame.seq for frame in islice(camera, 3)] == [0, 1, 2]
        assert next(iter(camera)).seq == 3


def test_a_camera_without_frames_is_awaited_and_the_reason_is_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with ScriptedCamera([ABSENT, ABSENT, make_frame(0), ABSENT, make_frame(1)]) as camera:
        frames = iter(camera)
        assert next(frames).seq == 0
        assert caplog.messages == ["scripted: waiting for a frame: absent: plug it in"]
        assert [frame.seq for frame in frames] == [1]
        assert len(caplog.messages) == 2


def test_a_camera_that_is_lost_ends_the_loop_with_its_error() -> None:
    with ScriptedCamera([make_frame(0), CameraLostError("unplugged")]) as camera:
        frames = iter(camera)
        next(frames)
        with pytest.raises(CameraLostError, match="unplugged"):
            next(frames)


@pytest.mark.parametrize("source", ["tum:desk", "synthetic", "freenect", "openni2:desk.oni"])
def test_a_loop_over_a_closed_camera_is_an_error_with_instructions(source: str) -> None:
    with pytest.raises(CameraError, match="not open; use `with`"):
        next(iter(open_camera(source)))
