"""All configured outputs are open, or none is."""

import errno
import socket
from pathlib import Path

import pytest

from drivers.camera import PlaybackMode
from drivers.core import InputError
from tests.vo_service.outputs.sample_updates import make_update
from vo_service.app import OutputsConfig, open_outputs
from vo_service.config_tables import DEFAULT_ENDPOINT, RerunConfig, ZenohConfig
from vo_service.outputs.trajectory.trajectory_file import TrajectoryFileOutput
from vo_service.outputs.zenoh.output import ConnectWithRetry, ZenohOutput, describe

pytestmark = pytest.mark.zenoh


def zenoh_at(port: int) -> ZenohConfig:
    return ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",))


def is_free(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == errno.ECONNREFUSED


def test_requested_outputs_are_opened_and_closed(free_port: int, tmp_path: Path) -> None:
    request = OutputsConfig(
        PlaybackMode.REALTIME, zenoh_at(free_port), trajectory=tmp_path / "poses.txt"
    )
    with open_outputs(request) as opened:
        assert [type(output) for output in opened.outputs] == [ZenohOutput, TrajectoryFileOutput]
        for output in opened.outputs:
            output.on_update(make_update(0))
    assert (tmp_path / "poses.txt").read_bytes().count(b"\n") == 1
    assert is_free(free_port)


def test_an_unwritable_trajectory_leaves_the_port_free(free_port: int, tmp_path: Path) -> None:
    request = OutputsConfig(
        PlaybackMode.REALTIME, zenoh_at(free_port), trajectory=tmp_path / "no" / "file"
    )
    with pytest.raises(InputError, match="cannot be written"), open_outputs(request):
        pass
    assert is_free(free_port)


def log_line(port: int) -> str:
    """The line of poses that are published at this port."""
    endpoint = f"tcp/127.0.0.1:{port}"
    return f"poses: kinect/odom at {endpoint} (kinect-vo listen --connect {endpoint})"


def test_the_log_has_only_the_addresses_of_active_outputs(free_port: int) -> None:
    lines: list[str] = []
    request = OutputsConfig(
        PlaybackMode.REALTIME,
        zenoh_at(free_port),
        connect_policy=ConnectWithRetry,
        log_line=lines.append,
    )
    with socket.create_server(("127.0.0.1", free_port)), open_outputs(request):
        assert lines == []
    with open_outputs(request):
        assert lines == [log_line(free_port)]


def test_the_command_that_reads_the_poses_has_their_prefix(free_port: int) -> None:
    at_default = ZenohConfig(prefix="robot1")
    assert describe(at_default) == f"{DEFAULT_ENDPOINT} (kinect-vo listen --prefix robot1)"
    over_tls = ZenohConfig(listen=(f"tls/127.0.0.1:{free_port}",))
    assert describe(over_tls).endswith("(kinect-vo listen)")


def test_the_endpoint_of_a_zenoh_file_is_logged(free_port: int, tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(f"{{listen: {{endpoints: ['tcp/127.0.0.1:{free_port}']}}}}")
    lines: list[str] = []
    request = OutputsConfig(
        PlaybackMode.REALTIME, ZenohConfig(config_file=file), log_line=lines.append
    )
    with open_outputs(request):
        assert lines == [log_line(free_port)]


def test_waiting_for_a_subscriber_times_out(free_port: int) -> None:
    request = OutputsConfig(PlaybackMode.LOCKSTEP, zenoh_at(free_port), wait_for_subscriber_s=0.1)
    with open_outputs(request) as opened:
        assert len(opened.outputs) == 1


@pytest.mark.parametrize(
    ("one", "other"),
    [("a.rrd", "./a.rrd"), ("serve", "serve"), ("connect", "connect:127.0.0.1:9876")],
)
def test_two_equal_rerun_targets_are_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, one: str, other: str
) -> None:
    monkeypatch.chdir(tmp_path)
    rerun = RerunConfig(targets=(one, other))
    with (
        pytest.raises(InputError, match=f"'{one}' and '{other}' are the same; remove one"),
        open_outputs(OutputsConfig(PlaybackMode.LOCKSTEP, zenoh=None, rerun=rerun)),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
