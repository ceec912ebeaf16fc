"""What is kept of maps that are loaded, by a keeper without a process."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from drivers.core.process.supervisor import BackgroundWorkerSpec
from drivers.core.shared_frames.record_ring import RecordRingMemory
from tests.vo_service.slam.mapper.wall_sequence import COARSE
from vo_service.slam.mapper import mapper_client as clerk
from vo_service.slam.mapper.mapper_client import MapperClient
from vo_service.slam.mapper.messages import (
    LoadMapResult,
    MapperMessage,
    MapperStatus,
    MapperWorkerConfig,
)

FIRST_AFTER = 77


@dataclass
class FakeSupervisor:
    """As the real one, with nobody behind it."""

    spec: BackgroundWorkerSpec
    config: MapperWorkerConfig
    on_message: Callable[[MapperMessage], None]
    on_exit: Callable[[], None]
    is_ready: bool = True
    is_unresponsive: bool = False
    sent: list[object] = field(default_factory=list)

    def send(self, order: object) -> None:
        self.sent.append(order)


@dataclass
class Desk:
    clerk: MapperClient
    keeper: FakeSupervisor
    looked_anew: list[None]

    def load(self, name: str, trouble: str = "") -> None:
        self.clerk.load(name)
        self.keeper.on_message(LoadMapResult(Path(f"/maps/{name}.places"), 4, trouble))


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Desk:
    keepers: list[FakeSupervisor] = []

    def keeper(*given: object) -> FakeSupervisor:
        keepers.append(FakeSupervisor(*given))  # type: ignore[arg-type]
        return keepers[0]

    monkeypatch.setattr(clerk, "WorkerSupervisor", keeper)
    looked: list[None] = []
    job = MapperWorkerConfig(RecordRingMemory(0, 0), 0, tmp_path, COARSE, 0)
    made = MapperClient(job, lambda said: None, lambda: looked.append(None), lambda: FIRST_AFTER)
    keepers[0].on_message(MapperStatus(3, frozenset(), frozenset({"home", "bad"})))
    return Desk(made, keepers[0], looked)


def test_a_process_that_is_started_again_begins_in_the_map_that_was_loaded(desk: Desk) -> None:
    desk.load("home")
    assert desk.clerk.state.loaded == "/maps/home.places"
    assert len(desk.looked_anew) == 1
    desk.keeper.on_exit()
    assert desk.keeper.config.map_config.load == "home"
    assert desk.keeper.config.first_frame == FIRST_AFTER
    assert desk.clerk.state.loaded == ""  # until it says so


def test_a_map_that_cannot_be_loaded_changes_nothing_and_is_told_until_the_next(desk: Desk) -> None:
    desk.load("home")
    desk.load("bad", trouble="bad.places: damaged map")
    assert desk.clerk.state.loaded == "/maps/home.places"
    assert desk.keeper.config.map_config.load == "home"
    assert desk.clerk.warning == "map: bad.places: damaged map"
    assert len(desk.looked_anew) == 1
    desk.clerk.load("home")
    assert desk.clerk.warning == ""
