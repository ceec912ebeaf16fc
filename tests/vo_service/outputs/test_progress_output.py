"""Progress of a run on a terminal."""

import io
from collections.abc import Callable

from tests.vo_service.fakes import make_status
from vo_service.outputs.state_log import ProgressOutput
from vo_service.terminal import Terminal
from vo_service.types import OdometryUpdate, TrackingState


class FakeProgressTerminal(io.StringIO):
    """A terminal that stores its output."""

    def isatty(self) -> bool:
        return True


def test_progress_shows_frame_state_and_inliers_and_is_cleared(
    make_update: Callable[..., OdometryUpdate],
) -> None:
    screen = FakeProgressTerminal()
    progress = ProgressOutput(Terminal(screen), "replay", 40)
    progress.on_update(make_update(9))
    progress.close()
    assert screen.getvalue().split("\r\x1b[K") == [
        "", "replay: tracking, 7 inliers, frame 10/40 (25%)", ""
    ]  # fmt: skip


def test_progress_shows_the_reason_for_a_missing_camera() -> None:
    screen = FakeProgressTerminal()
    progress = ProgressOutput(Terminal(screen), "demo", 40)
    progress.on_status(make_status())
    opening = "opening: preparing its room"
    progress.on_status(make_status(state=TrackingState.NO_CAMERA, reason=opening))
    assert screen.getvalue() == "\r\x1b[Kdemo: opening: preparing its room"
