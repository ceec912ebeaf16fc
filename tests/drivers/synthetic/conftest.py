"""Small, quickly rendered virtual cameras."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import PinholeCamera
from drivers.synthetic import texture_atlas
from drivers.synthetic.config import SyntheticConfig
from drivers.synthetic.motions import make_motion
from drivers.synthetic.renderer import Renderer, RoomModel
from drivers.synthetic.room import ROOM_HEIGHT_M
from tests.drivers.synthetic.cached_cameras import CachedCameras, RendererFactory

SMALL = PinholeCamera(128, 96, 105.0, 105.0, 63.5, 47.5)


def make_small(config: SyntheticConfig) -> SyntheticConfig:
    return replace(config, camera=SMALL, duration_s=0.2, texel_m=0.02)


# Six frames, with all sensor faults of a Kinect and with none.
FAULTY = make_small(SyntheticConfig())
IDEAL = make_small(SyntheticConfig.ideal())


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave all surfaces gray: painting takes most of the time where only depth is looked at."""
    gray = np.full((4, 4, 3), 128, np.uint8)
    monkeypatch.setattr(texture_atlas, "_paint_face", lambda *_: gray)


@pytest.fixture(scope="session")
def sequence_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of rendered sequences, so that each is rendered once for all tests."""
    return tmp_path_factory.mktemp("sequence_folder")


@pytest.fixture
def cached_cameras(sequence_folder: Path, shared_renderer: RendererFactory) -> CachedCameras:
    return CachedCameras(sequence_folder, shared_renderer)


@pytest.fixture(scope="session")
def room() -> RoomModel:
    """One room, without furniture in the way of the default motion."""
    config = make_small(SyntheticConfig())
    return RoomModel.build(config, make_motion(config, ROOM_HEIGHT_M), threads=2)


@pytest.fixture(scope="session")
def shared_renderer(room: RoomModel) -> RendererFactory:
    """Make renderers of that room, for any motion and sensor."""
    return lambda variant: Renderer(variant, make_motion(variant, ROOM_HEIGHT_M), room)
