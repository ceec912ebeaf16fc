"""What services that the tests start in processes of their own need before they can be quick."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.core.process import worker_spec
from tests import forked_process
from tests.forked_process import forked_workers
from tests.shared_fixture import make_once
from tests.vo_service.service_process import START_TIMEOUT_S
from tests.waiting import DEFAULT_TIMEOUT_S
from vo_service.cli import run
from vo_service.tools.compare.batch import RUN_WORKER


@pytest.fixture(scope="session", autouse=True)
def patience() -> Iterator[None]:
    """Wait for the end of a service and of its processes for as long as it takes.

    On a busy machine they would be left to themselves, and the next tests would meet them; a
    service in this very process would be ended by force, and pytest with it.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_spec, "FINISHING_TIMEOUT_S", DEFAULT_TIMEOUT_S)
        patch.setattr(run, "MAX_SHUTDOWN_S", DEFAULT_TIMEOUT_S)
        yield


@pytest.fixture
def forked_runs() -> Iterator[None]:
    """Processes of runs begin with what they need: see `tests.forked_process`."""
    with forked_workers({RUN_WORKER.function}):
        yield


@pytest.fixture(scope="session")
def render_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache for rendered rooms. The kernels, which all tests share, are compiled afterwards."""

    def warm_up(folder: Path) -> None:
        environment = os.environ | {"CACHE_DIRECTORY": str(folder)}
        done = forked_process.run(
            [*forked_process.KINECT_VO, "warm-up"], START_TIMEOUT_S, env=environment
        )
        assert done.returncode == 0, done.stderr

    return make_once(tmp_path_factory, "render_cache", warm_up)
