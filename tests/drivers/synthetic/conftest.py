"""Small, quickly rendered virtual cameras."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.camera import PinholeCamera
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motion.factory import make_motion
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.synthetic.room import ROOM_HEIGHT_M
from tests.drivers.synthetic.cached_cameras import CachedCameras, RendererFactory

SMALL = PinholeCamera(128, 96, 105.0, 105.0, 63.5, 47.5)


def make_small(config: SyntheticConfig) -> SyntheticConfig:
    return replace(config, camera=SMALL, duration_s=0.2, texel_m=0.02)


@pytest.fixture
def faulty() -> SyntheticConfig:
    """All of the Kinect's own faults, six frames."""
    return make_small(SyntheticConfig())


@pytest.fixture
def ideal() -> SyntheticConfig:
    """No fault at all, six frames."""
    return make_small(SyntheticConfig.ideal())


@pytest.fixture(scope="session")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where films are kept, so that each is rendered once for all tests."""
    return tmp_path_factory.mktemp("films")


@pytest.fixture
def cached_cameras(films: Path, shared_renderer: RendererFactory) -> CachedCameras:
    return CachedCameras(films, shared_renderer)


@pytest.fixture(scope="session")
def room() -> RoomModel:
    """One room, free of furniture where the default motion goes."""
    config = make_small(SyntheticConfig())
    return RoomModel.build(config, make_motion(config, ROOM_HEIGHT_M), threads=2)


@pytest.fixture(scope="session")
def shared_renderer(room: RoomModel) -> RendererFactory:
    """Renderers through that room, whatever their motion and their sensor are like."""
    return lambda variant: Renderer(variant, make_motion(variant, ROOM_HEIGHT_M), room)
