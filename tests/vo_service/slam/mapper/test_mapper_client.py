"""The mapper in the service, without a process: which map a restarted process is to load."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from drivers.core.process.record_ring import RecordRingReader
from drivers.core.process.worker_spec import WorkerSpec
from tests.vo_service.outputs.recorder.recorder_inputs import command_error
from tests.vo_service.slam.mapper.wall_sequence import COARSE, make_wall_update
from tests.waiting import wait_until
from vo_service import process_output
from vo_service.slam.mapper.client import LiveMapper
from vo_service.slam.mapper.messages import (
    LoadMapResult,
    MapperMessage,
    MapperStatus,
    MapperWorkerConfig,
)


@dataclass
class FakeClient:
    """Client without a process."""

    spec: WorkerSpec
    make_config: Callable[[], MapperWorkerConfig]
    on_message: Callable[[MapperMessage], None]
    on_exit: Callable[[str], bool]
    backoff: None
    is_ready: bool = True
    is_unresponsive: bool = False
    sent: list[object] = field(default_factory=list)

    def send(self, request: object) -> None:
        self.sent.append(request)

    def close(self) -> None:
        """Do nothing: there is no process."""


@dataclass
class MapperFixture:
    mapper: LiveMapper
    client: FakeClient

    def load(self, name: str, error: str = "") -> None:
        self.mapper.load(name)
        self.client.on_message(LoadMapResult(Path(f"/maps/{name}.keyframes"), 4, error))

    @property
    def sent_frames(self) -> int:
        return RecordRingReader(self.client.make_config().frame_ring).record_count

    def stand_until_sent(self, frames: int) -> None:
        """A frame of a camera that stands, which is sent if a keyframe is needed."""
        self.mapper.on_update(make_wall_update(0))
        wait_until(lambda: self.sent_frames == frames)


@pytest.fixture
def fixture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[MapperFixture]:
    clients: list[FakeClient] = []

    def make_client(*given: object) -> FakeClient:
        clients.append(FakeClient(*given))  # type: ignore[arg-type]
        return clients[0]

    monkeypatch.setattr(process_output, "WorkerClient", make_client)
    with closing(LiveMapper(COARSE, tmp_path)) as mapper:
        clients[0].on_message(MapperStatus(3, frozenset(), frozenset({"home", "bad"})))
        yield MapperFixture(mapper, clients[0])


def test_a_restarted_process_loads_the_map_again(fixture: MapperFixture) -> None:
    fixture.stand_until_sent(1)
    fixture.load("home")
    assert fixture.mapper.state.loaded == "/maps/home.keyframes"
    fixture.stand_until_sent(2)  # also a keyframe of the loaded map
    fixture.mapper.configure(COARSE)  # a reload of the configuration does not forget it
    fixture.client.on_exit("crashed")
    assert fixture.client.make_config().map_config.load == "home"
    assert fixture.client.make_config().first_frame == 2
    assert fixture.mapper.state.loaded == ""  # until it says so
    fixture.stand_until_sent(3)


def test_a_map_that_cannot_be_loaded_changes_nothing_and_is_reported_until_the_next(
    fixture: MapperFixture,
) -> None:
    fixture.load("home")
    fixture.load("bad", error="bad.keyframes: damaged map")
    assert fixture.mapper.state.loaded == "/maps/home.keyframes"
    assert fixture.client.make_config().map_config.load == "home"
    assert fixture.mapper.warning == "map: bad.keyframes: damaged map"
    fixture.mapper.load("home")
    assert fixture.mapper.warning == ""


def test_a_map_without_a_grid_is_a_warning_in_one_line(
    fixture: MapperFixture, caplog: pytest.LogCaptureFixture
) -> None:
    file = Path("/maps/old.keyframes")
    fixture.client.on_message(LoadMapResult(file, 4, grid_fault="it has no cells"))
    (line,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert line == (
        f"map: {file}: it has no cells; the grid is empty until its places are seen again"
    )
    assert fixture.mapper.warning == ""


def test_a_process_that_does_not_respond_is_reported_and_gets_no_request(
    fixture: MapperFixture,
) -> None:
    fixture.client.is_unresponsive = True
    assert fixture.mapper.warning == "map: its process does not respond; the disk may hang"
    assert "does not respond" in command_error(lambda: fixture.mapper.save("wall"))
    assert "does not respond" in command_error(lambda: fixture.mapper.load("home"))
    assert (fixture.client.sent, fixture.mapper.state.saving) == ([], "")


def test_a_loaded_map_is_saved_only_with_a_new_keyframe(fixture: MapperFixture) -> None:
    fixture.load("home")
    assert "no frame has been tracked yet" in command_error(lambda: fixture.mapper.save("new"))
    fixture.client.on_message(MapperStatus(1, frozenset(), frozenset({"home"})))
    assert fixture.mapper.save("new").saving.endswith("new.ply")
