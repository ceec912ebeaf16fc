"""Progress of a run on a terminal."""

from tests.vo_service.captured_terminal import CapturedTerminal
from tests.vo_service.fakes import make_status
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.outputs.progress import ProgressOutput
from vo_service.terminal import Terminal
from vo_service.types.odometry_update import TrackingState


def test_progress_shows_frame_state_and_inliers_and_is_cleared() -> None:
    screen = CapturedTerminal()
    progress = ProgressOutput(Terminal(screen), "replay", 40)
    progress.on_update(make_update(9))
    progress.close()
    assert screen.drawn[1].startswith("replay: tracking, 7 inliers, frame 10/40 (25%)")
    assert screen.drawn[-1] == ""


def test_progress_shows_the_reason_for_a_missing_camera() -> None:
    screen = CapturedTerminal()
    progress = ProgressOutput(Terminal(screen), "demo", 40)
    progress.on_status(make_status())
    opening = "starting: preparing its room"
    progress.on_status(make_status(state=TrackingState.NO_CAMERA, reason=opening))
    assert screen.drawn[-1] == "demo: starting: preparing its room"
