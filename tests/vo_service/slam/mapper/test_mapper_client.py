"""Mapper client with a fake supervisor."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from drivers.core.process.record_ring import RecordRingMemory
from drivers.core.process.worker_spec import WorkerSpec
from tests.vo_service.slam.mapper.wall_sequence import COARSE
from vo_service.slam.mapper import client as mapper
from vo_service.slam.mapper.client import MapperClient
from vo_service.slam.mapper.messages import (
    LoadMapResult,
    MapperMessage,
    MapperStatus,
    MapperWorkerConfig,
)

FIRST_AFTER = 77


@dataclass
class FakeSupervisor:
    """Supervisor without a process."""

    spec: WorkerSpec
    make_config: Callable[[], MapperWorkerConfig]
    on_message: Callable[[MapperMessage], None]
    on_exit: Callable[[str], bool]
    is_ready: bool = True
    is_unresponsive: bool = False
    sent: list[object] = field(default_factory=list)

    def send(self, request: object) -> None:
        self.sent.append(request)


@dataclass
class ClientFixture:
    client: MapperClient
    supervisor: FakeSupervisor
    loaded_events: list[None]

    def load(self, name: str, error: str = "") -> None:
        self.client.load(name)
        self.supervisor.on_message(LoadMapResult(Path(f"/maps/{name}.keyframes"), 4, error))


@pytest.fixture
def fixture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ClientFixture:
    supervisors: list[FakeSupervisor] = []

    def make_supervisor(*given: object) -> FakeSupervisor:
        supervisors.append(FakeSupervisor(*given))  # type: ignore[arg-type]
        return supervisors[0]

    monkeypatch.setattr(mapper, "WorkerClient", make_supervisor)
    loaded_events: list[None] = []
    job = MapperWorkerConfig(RecordRingMemory(0, 0), 0, tmp_path, COARSE)
    made = MapperClient(
        job, lambda published: None, lambda: loaded_events.append(None), lambda: FIRST_AFTER
    )
    supervisors[0].on_message(MapperStatus(3, frozenset(), frozenset({"home", "bad"})))
    return ClientFixture(made, supervisors[0], loaded_events)


def test_a_restarted_process_loads_the_map_again(
    fixture: ClientFixture,
) -> None:
    fixture.load("home")
    assert fixture.client.state.loaded == "/maps/home.keyframes"
    assert len(fixture.loaded_events) == 1
    fixture.supervisor.on_exit("crashed")
    assert fixture.supervisor.make_config().map_config.load == "home"
    assert fixture.supervisor.make_config().first_frame == FIRST_AFTER
    assert fixture.client.state.loaded == ""  # until it says so


def test_a_map_that_cannot_be_loaded_changes_nothing_and_is_reported_until_the_next(
    fixture: ClientFixture,
) -> None:
    fixture.load("home")
    fixture.load("bad", error="bad.keyframes: damaged map")
    assert fixture.client.state.loaded == "/maps/home.keyframes"
    assert fixture.supervisor.make_config().map_config.load == "home"
    assert fixture.client.warning == "map: bad.keyframes: damaged map"
    assert len(fixture.loaded_events) == 1
    fixture.client.load("home")
    assert fixture.client.warning == ""
