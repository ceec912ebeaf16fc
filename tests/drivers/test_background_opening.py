"""A camera that takes long to open keeps nobody waiting."""

import threading
from collections.abc import Iterator

import pytest

from drivers.background_opening import BackgroundOpening, Cancellable
from drivers.camera import CameraState, NoFrameYet
from drivers.errors import CameraNotFoundError
from tests.vo_service.fakes import ScriptedCamera, frame


class SlowCamera(ScriptedCamera):
    """Opens step by step, as it is told."""

    def __init__(self, progress: Cancellable) -> None:
        super().__init__([frame(0), frame(1)], [frame(2)])
        self.go_on = threading.Semaphore(0)
        self._progress = progress

    def open(self) -> None:
        """Two steps."""
        for step in range(2):
            self.go_on.acquire(timeout=100)
            self._progress(step, 2)
        super().open()


@pytest.fixture
def slow() -> Iterator[tuple[SlowCamera, BackgroundOpening]]:
    progress = Cancellable(lambda done, total: None)
    camera = SlowCamera(progress)
    opened = BackgroundOpening(camera, progress, "rendering")
    yield camera, opened
    camera.go_on.release(9)
    opened.close()


def test_until_it_is_open_there_is_no_frame_and_a_reason(
    slow: tuple[SlowCamera, BackgroundOpening],
) -> None:
    camera, opened = slow
    opened.open()
    with pytest.raises(NoFrameYet):
        opened.read(0.01)
    assert str(opened.condition) == "opening: rendering"
    camera.go_on.release(2)
    assert opened.read(10).seq == 0
    assert opened.condition.state is CameraState.STREAMING
    assert opened.counters.delivered == 1


def test_closing_cancels_an_opening(slow: tuple[SlowCamera, BackgroundOpening]) -> None:
    camera, opened = slow
    opened.open()
    camera.go_on.release(1)
    threading.Timer(0.05, camera.go_on.release).start()
    opened.close()
    assert camera.opened == 0


def test_it_can_be_opened_again(slow: tuple[SlowCamera, BackgroundOpening]) -> None:
    camera, opened = slow
    camera.go_on.release(4)
    for seq in (0, 2):
        opened.open()
        assert opened.read(10).seq == seq
        opened.close()


def test_what_is_wrong_with_it_reaches_the_reader() -> None:
    camera = ScriptedCamera(CameraNotFoundError("not there"))
    opened = BackgroundOpening(camera, Cancellable(lambda done, total: None), "opening")
    opened.open()
    with pytest.raises(CameraNotFoundError, match="not there"):
        opened.read(10)
    opened.close()
