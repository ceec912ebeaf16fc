"""A camera's script, and cameras that are closed whatever happens."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.camera import PlaybackMode, RgbdCamera
from drivers.subprocess_camera.camera import SubprocessCamera
from drivers.subprocess_camera.messages import Timeouts
from tests.drivers.subprocess_camera.scripted_cameras import FileScriptedCamera

MakeSubprocessCamera = Callable[..., SubprocessCamera]
# No driver is taken for hung because the machine is busy.
LONG_TIMEOUTS = Timeouts(launching_s=100.0, opening_s=100.0, heartbeat_s=100.0, closing_s=100.0)


@pytest.fixture
def script(tmp_path: Path) -> Path:
    """What the scripted camera does; it works until something is written here."""
    path = tmp_path / "script"
    path.write_text("")
    return path


@pytest.fixture
def make_subprocess_camera(script: Path) -> Iterator[MakeSubprocessCamera]:
    """Makes isolated cameras: ``make_subprocess_camera(OnceLost, pace=Pace.LOCKSTEP)``."""
    with ExitStack() as stack:

        def make(
            kind: type[FileScriptedCamera] = FileScriptedCamera,
            *,
            pace: PlaybackMode = PlaybackMode.REALTIME,
            limits: Timeouts = LONG_TIMEOUTS,
            **settings: Any,
        ) -> SubprocessCamera:
            recipe: Callable[[], RgbdCamera] = partial(kind, script, **settings)
            camera = SubprocessCamera(kind.name, kind.clock, recipe, pace, limits)
            stack.callback(camera.close)
            return camera

        yield make
