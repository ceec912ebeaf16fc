"""Key files of a Zenoh configuration, and what it leaves to our defaults."""

import json
from pathlib import Path

import pytest

from drivers.core import InputError
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.addresses import connect_endpoints
from vo_service.outputs.zenoh.zenoh_config import build_zenoh_config, read_zenoh_config

KEY = "transport/link/tls/listen_private_key"


def configuration(folder: Path, name: str) -> Path:
    file = folder / "robot.json5"
    tls = f"{{listen_private_key: {json.dumps(name)}}}"
    file.write_text(f"{{transport: {{link: {{tls: {tls}}}}}}}")
    return file


def resolved_key(file: Path) -> str:
    return str(json.loads(read_zenoh_config(file).get_json(KEY)))


def test_a_key_is_found_beside_its_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    (tmp_path / "tls.key").write_text("key")
    monkeypatch.chdir(tmp_path.parent)
    relative = configuration(tmp_path, "tls.key").relative_to(tmp_path.parent)
    assert resolved_key(relative) == str(tmp_path / "tls.key")


def test_a_systemd_credential_takes_precedence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    credentials = tmp_path / "credentials"
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(credentials))
    (tmp_path / "tls.key").write_text("key")
    assert resolved_key(configuration(tmp_path, "tls.key")) == str(tmp_path / "tls.key")
    credentials.mkdir()
    (credentials / "tls.key").write_text("key")
    assert resolved_key(configuration(tmp_path, "tls.key")) == str(credentials / "tls.key")


def test_an_absolute_path_is_kept(tmp_path: Path) -> None:
    key = tmp_path / "elsewhere.key"
    key.write_text("key")
    assert resolved_key(configuration(tmp_path, str(key))) == str(key)


def test_a_missing_key_is_reported_with_the_searched_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", "/run/credentials/kinect-vo")
    with pytest.raises(InputError) as caught:
        read_zenoh_config(configuration(tmp_path, "tls.key"))
    text = str(caught.value)
    assert "robot.json5: transport.link.tls.listen_private_key" in text
    assert f"No such file or directory in /run/credentials/kinect-vo or {tmp_path}" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{\n  mode: \n}", "robot.json5:3: not JSON5"),
        ("{modus: 1}", "robot.json5: not a Zenoh configuration: unknown field `modus`"),
    ],
)
def test_a_wrong_file_is_reported_with_the_reason(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "robot.json5"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        read_zenoh_config(file)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "connect",
    [
        "['tcp/a:1', 'tls/b:2']",
        "{peer: ['tcp/a:1', 'tls/b:2'], router: ['tcp/c:3']}",
    ],
)
def test_a_file_may_set_connect_endpoints_in_several_formats(tmp_path: Path, connect: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(f"{{connect: {{endpoints: {connect}}}}}")
    assert connect_endpoints(ZenohConfig(config_file=file)) == ("tcp/a:1", "tls/b:2")


def test_without_a_file_the_configuration_sets_the_endpoints() -> None:
    assert connect_endpoints(ZenohConfig(connect=("tcp/a:1",))) == ("tcp/a:1",)
    assert connect_endpoints(ZenohConfig()) == ()


LOCAL = Path(__file__).parents[4] / "config" / "zenoh" / "local.json5"


def test_the_local_file_changes_nothing() -> None:
    with_file = build_zenoh_config(ZenohConfig(config_file=LOCAL))
    assert json.loads(str(with_file)) == json.loads(str(build_zenoh_config(ZenohConfig())))


def test_a_client_sees_a_service_within_a_second_of_its_start_unless_the_file_says_otherwise(
    tmp_path: Path,
) -> None:
    retry = json.loads(build_zenoh_config(ZenohConfig()).get_json("connect/retry"))
    assert retry["period_init_ms"] < retry["period_max_ms"] <= 1000
    file = tmp_path / "robot.json5"
    file.write_text("{connect: {retry: {period_max_ms: 8000}}}")
    theirs = build_zenoh_config(ZenohConfig(config_file=file)).get_json("connect/retry")
    assert json.loads(theirs)["period_max_ms"] == 8000
