"""Virtual cameras with cached frames."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drivers.camera import EndOfStream, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.faulty_camera import Fault
from drivers.pacing import HOST_CLOCK
from drivers.synthetic.camera import make_synthetic_camera
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.rendered_sequence import create_sequence, files_for_config
from drivers.synthetic.renderer import Renderer
from tests.drivers.fake_host import FakeHost

RendererFactory = Callable[[SyntheticConfig], Renderer]


def read_frames(camera: RgbdCamera) -> list[RgbdFrame]:
    frames: list[RgbdFrame] = []
    with contextlib.suppress(EndOfStream):
        while len(frames) < 100:
            frames.append(camera.read(60.0))
    return frames


def fill_sequence(config: SyntheticConfig, folder: Path, shared_renderer: RendererFactory) -> None:
    """Render missing frames in this process, which is faster than another for a few frames."""
    sequence = create_sequence(files_for_config(config, folder))
    missing = sequence.missing_frames()
    if missing.size:
        renderer = shared_renderer(config)
        for index in missing:
            sequence.write(int(index), renderer.render(int(index)))
    sequence.close()


class CachedCameras:
    """Cameras whose frames are rendered once for all tests."""

    def __init__(self, folder: Path, shared_renderer: RendererFactory) -> None:
        self._folder, self._make_renderer = folder, shared_renderer

    def open_camera(
        self,
        config: SyntheticConfig,
        pace: PlaybackMode = PlaybackMode.LOCKSTEP,
        host: FakeHost | None = None,
    ) -> RgbdCamera:
        fill_sequence(config, self._folder, self._make_renderer)
        clock = HOST_CLOCK if host is None else host.clock
        return make_synthetic_camera(config, self._folder, pace, host=clock)

    def read_frames(self, config: SyntheticConfig, *faults: Fault) -> list[RgbdFrame]:
        with self.open_camera(replace(config, faults=faults)) as camera:
            return read_frames(camera)
