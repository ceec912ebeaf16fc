"""SIGTERM, SIGINT and SIGHUP at every stage of a service's life."""

import signal
from itertools import cycle
from pathlib import Path

import pytest

from tests.vo_service.lifecycle_stages import STAGES, LifecycleStage
from tests.vo_service.service_process import NO_MAP_CONFIG, STOP_TIMEOUT_S
from tests.vo_service.service_runner import service_runner

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

# Both signals have one handler: each stage is left by one of them, and each of them leaves three.
CASES = tuple(zip(STAGES, cycle((signal.SIGTERM, signal.SIGINT)), strict=False))


@pytest.mark.parametrize(
    ("stage", "number"), CASES, ids=[f"{s.name.replace(' ', '-')}-{n.name}" for s, n in CASES]
)
def test_sighup_changes_nothing_and_sigterm_ends_cleanly(
    stage: LifecycleStage, number: signal.Signals, render_cache: Path, tmp_path: Path
) -> None:
    with service_runner(tmp_path / "stage", render_cache, stage.config + NO_MAP_CONFIG) as live:
        service = live.start(popen=stage.popen)
        stage.reach(live)
        service.process.send_signal(signal.SIGHUP)
        if stage.keeps_running:
            status_count = len(service.received.statuses)
            service.wait_for_status(lambda _: len(service.received.statuses) > status_count + 1)
        service.process.send_signal(number)
        assert service.process.wait(STOP_TIMEOUT_S) == 0
        assert "ended by force" not in service.log
        live.check()
        stage.check(live)
