"""Virtual cameras whose films are kept, and a host whose clock only moves when somebody sleeps."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drivers.camera import EndOfStream, Pace, RgbdFrame
from drivers.synthetic.camera import Preparation, SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.faults import Fault
from drivers.synthetic.pacing import HostClock
from drivers.synthetic.render import Renderer
from drivers.synthetic.rendered_sequence import create_sequence, sequence_files

Shoot = Callable[[SyntheticConfig], Renderer]


class FakeHost:
    """A clock that moves only when someone sleeps."""

    def __init__(self) -> None:
        self.now_s = 5000.0

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    @property
    def clock(self) -> HostClock:
        return HostClock(lambda: self.now_s, self.sleep)


def frames_of(camera: SyntheticCamera) -> list[RgbdFrame]:
    frames: list[RgbdFrame] = []
    with contextlib.suppress(EndOfStream):
        while len(frames) < 100:
            frames.append(camera.read(60.0))
    return frames


def fill_sequence(config: SyntheticConfig, folder: Path, shoot: Shoot) -> None:
    """Render what is missing in this process: quicker than in another for a few frames."""
    sequence = create_sequence(sequence_files(config, folder))
    missing = sequence.missing()
    if missing.size:
        renderer = shoot(config)
        for index in missing:
            sequence.write(int(index), renderer.render(int(index)))
    sequence.close()


class Studio:
    """Cameras whose films are rendered once for all tests."""

    def __init__(self, films: Path, shoot: Shoot) -> None:
        self._films, self._shoot = films, shoot

    def camera(
        self,
        config: SyntheticConfig,
        pace: Pace = Pace.LOCKSTEP,
        host: FakeHost | None = None,
    ) -> SyntheticCamera:
        fill_sequence(config, self._films, self._shoot)
        clock = HostClock() if host is None else host.clock
        return SyntheticCamera(config, pace, Preparation(cache_dir=self._films), clock)

    def play(self, config: SyntheticConfig, *faults: Fault) -> list[RgbdFrame]:
        with self.camera(replace(config, faults=faults)) as camera:
            return frames_of(camera)
