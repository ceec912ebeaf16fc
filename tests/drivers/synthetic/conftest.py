"""Small, quickly rendered virtual cameras."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import PinholeCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motion import make_path
from drivers.synthetic.render import Renderer, Room
from drivers.synthetic.scene import ROOM_HEIGHT_M
from tests.drivers.synthetic.studio import Shoot, Studio

SMALL = PinholeCamera(128, 96, 105.0, 105.0, 63.5, 47.5)


def small(config: SyntheticConfig) -> SyntheticConfig:
    return replace(config, camera=SMALL, duration_s=0.2, texel_m=0.02)


@pytest.fixture
def faulty() -> SyntheticConfig:
    """All of the Kinect's own faults, six frames."""
    return small(SyntheticConfig())


@pytest.fixture
def ideal() -> SyntheticConfig:
    """No fault at all, six frames."""
    return small(SyntheticConfig.ideal())


@pytest.fixture(scope="session")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where films are kept, so that each is rendered once for all tests."""
    return tmp_path_factory.mktemp("films")


@pytest.fixture
def studio(films: Path, shoot: Shoot) -> Studio:
    return Studio(films, shoot)


@pytest.fixture(scope="session")
def room() -> Room:
    """One room, free of furniture where the default motion goes."""
    config = small(SyntheticConfig())
    return Room.build(config, make_path(config, ROOM_HEIGHT_M), threads=2)


@pytest.fixture(scope="session")
def shoot(room: Room) -> Shoot:
    """Renderers through that room, whatever their motion and their sensor are like."""
    return lambda variant: Renderer(variant, make_path(variant, ROOM_HEIGHT_M), room)
