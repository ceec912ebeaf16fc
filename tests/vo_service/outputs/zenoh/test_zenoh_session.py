"""Opening of sessions, and the messages of errors."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.core import InputError, UserFacingError
from tests.ports import listening_addresses
from vo_service.config_tables import ZenohConfig, check_prefix
from vo_service.outputs.zenoh.session import open_session


@pytest.mark.zenoh
def test_a_port_in_use_is_one_line_with_a_remedy() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(UserFacingError) as caught:
            open_session(ZenohConfig(listen=(endpoint,)))
    text = str(caught.value)
    assert not isinstance(caught.value, InputError)
    assert f"{endpoint}: the port is in use, probably by another kinect-vo" in text
    assert "zenoh.listen" in text
    assert "--no-publish" in text
    assert "\n" not in text


@pytest.mark.subprocess
def test_zenoh_itself_prints_nothing(free_port: int) -> None:
    script = (
        "from drivers.core import UserFacingError\n"
        "from vo_service.config_tables import ZenohConfig\n"
        "from vo_service.outputs.zenoh.session import open_session\n"
        f"config = ZenohConfig(listen=('tcp/127.0.0.1:{free_port}',))\n"
        "session = open_session(config)\n"
        "try: open_session(config)\n"
        "except UserFacingError: print('refused')\n"
        "session.close()"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.stdout, done.stderr, done.returncode) == ("refused\n", "", 0)


@pytest.mark.zenoh
@pytest.mark.parametrize(
    "endpoint",
    ["nonsense", "tcp/127.0.0.1", "tcp/127.0.0.1:99999", "tcp/127.0.0.1:80x", "foo/127.0.0.1:7450"],
)
def test_an_invalid_endpoint_is_reported(endpoint: str) -> None:
    with pytest.raises(InputError) as caught:
        open_session(ZenohConfig(listen=(endpoint,)))
    assert endpoint in str(caught.value)
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


@pytest.mark.parametrize("prefix", ["kinect", "robot1/kinect", "a-b_c.d/E2"])
def test_plain_names_are_valid_prefixes(prefix: str) -> None:
    assert check_prefix(prefix) == prefix


@pytest.mark.parametrize(
    "prefix", ["", "/kinect", "kinect/", "a//b", "*", "a/**", "a$*", "a b", "a#b", "@x", "a\n"]
)
def test_other_names_are_invalid_prefixes(prefix: str) -> None:
    with pytest.raises(InputError, match="zenoh prefix"):
        check_prefix(prefix)


@pytest.mark.zenoh
def test_a_session_without_listen_listens_nowhere() -> None:
    before = listening_addresses(os.getpid())
    with open_session(ZenohConfig(listen=())):
        assert listening_addresses(os.getpid()) == before


@pytest.mark.zenoh
def test_an_empty_file_exposes_nothing(tmp_path: Path, free_port: int) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ /* nothing */ }")
    before = listening_addresses(os.getpid())
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with open_session(ZenohConfig(listen=(endpoint,), config_file=file)):
        assert listening_addresses(os.getpid()) == before | {"127.0.0.1"}


@pytest.mark.zenoh
def test_settings_of_a_file_are_kept(tmp_path: Path, free_port: int) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(f"{{ listen: {{ endpoints: ['tcp/127.0.0.1:{free_port}'] }}, }}")
    with (
        open_session(ZenohConfig(listen=("tcp/127.0.0.1:1",), config_file=file)),
        socket.create_connection(("127.0.0.1", free_port), timeout=5),
    ):
        pass
