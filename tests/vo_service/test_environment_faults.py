"""Faults around a service that streams, through all of which it goes on; and its deaths."""

import json
import os
import signal
import socket
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from tests.ports import free_port
from tests.resource_leaks import child_pids_of, is_alive
from tests.simulators.zenoh_router import running_router
from tests.vo_service.environment_faults import (
    ENVIRONMENT_FAULTS,
    EnvironmentFault,
    ServiceEnvironment,
    run_fault,
)
from tests.vo_service.service_process import (
    NO_LOOP_CLOSURE_CONFIG,
    ONLY_POSES_CONFIG,
    START_TIMEOUT_S,
)
from tests.vo_service.service_runner import CAMERA, ServiceRunner, service_runner
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

# So that a pose is not lost for another reason: a machine that is busy for a tenth of a second. And
# tests that wait for seconds leave the processors to others.
SLOWLY = "rate_hz = 5.0\n"


@pytest.fixture(scope="module")
def around(
    render_cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServiceEnvironment]:
    """A service on a router; it must live to the end, and then end in order."""
    folder, router_at = tmp_path_factory.mktemp("around"), f"tcp/127.0.0.1:{free_port()}"
    config = f"connect = {json.dumps([router_at])}\n{CAMERA}{SLOWLY}{NO_LOOP_CLOSURE_CONFIG}"
    with (
        running_router(router_at) as router,
        service_runner(folder, render_cache, config) as runner,
    ):
        service = runner.start()
        service.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
        yield ServiceEnvironment(runner, router)
        assert service.stop() == 0
        runner.check()


@pytest.fixture
def runner(render_cache: Path, tmp_path: Path) -> Iterator[ServiceRunner]:
    """A stage of its own."""
    with service_runner(
        tmp_path / "runner", render_cache, CAMERA + SLOWLY + NO_LOOP_CLOSURE_CONFIG
    ) as runner:
        yield runner


@pytest.mark.parametrize(
    "fault", ENVIRONMENT_FAULTS, ids=lambda fault: fault.name.replace(" ", "-")
)
def test_an_environment_fault_is_reported_and_costs_no_pose(
    fault: EnvironmentFault, around: ServiceEnvironment
) -> None:
    received = around.runner.service.received
    first = len(received.poses)
    run_fault(fault, around)
    assert received.wait_for(lambda: len(received.poses) > first + 5, DEFAULT_TIMEOUT_S)
    poses = received.poses[first:]
    assert all(after.seq == before.seq + 1 for before, after in pairwise(poses))
    assert {pose.state for pose in poses} == {"tracking"}


def test_killed_service_leaves_no_process_and_publishes_after_restart(
    runner: ServiceRunner,
) -> None:
    service = runner.start()
    service.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
    children = child_pids_of(service.process.pid)
    os.kill(service.process.pid, signal.SIGKILL)
    service.process.wait()
    again = runner.start()
    again.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
    wait_until(lambda: not any(is_alive(child) for child in children), "its children to go")
    assert again.received.poses[0].epoch == 0
    assert again.stop() == 0
    runner.check()


def test_a_port_in_use_is_reported_and_retried(render_cache: Path, tmp_path: Path) -> None:
    config = f"{CAMERA}{SLOWLY}{ONLY_POSES_CONFIG}"
    with (
        service_runner(tmp_path / "runner", render_cache, config) as runner,
        socket.socket() as taken,
    ):
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", runner.port))
        taken.listen()
        service = runner.start()
        wait_until(lambda: f"cannot listen on tcp/127.0.0.1:{runner.port}" in service.log)
        assert "the port is in use" in service.log
        taken.close()
        service.wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
        service.wait_for_status(lambda status: not status["warnings"])
        assert service.stop() == 0
        runner.check()
