"""``config check``: what a configuration relies on is looked at before anyone relies on it."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core import InputError
from tests.ports import is_listening
from tests.resource_leaks import count_open_files
from tests.vo_service.security.tls_network import HOST, ZENOH_FILES, make_keys, make_network
from vo_service.cli.config import check_config

pytestmark = pytest.mark.zenoh


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_keys(tmp_path_factory.mktemp("keys"))


def config(folder: Path, text: str) -> Path:
    file = folder / "kinect.toml"
    file.write_text(f"schema = 1\n{text}")
    return file


def test_all_defaults_are_valid(tmp_path: Path) -> None:
    assert check_config(config(tmp_path, "")) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[camera]\nsource = "freenect"\nfile = "none.toml"', "none.toml: cannot be read"),
        ('[camera]\nsource = "synthetic"\nfile = "any.toml"', "has its own calibration"),
        ('[camera]\nsource = "tum:nowhere"', "`camera.source`: nowhere: no such folder"),
        ('[rerun]\ntargets = ["serf"]', "'serf': use serve, connect"),
        ('[rerun]\ntargets = ["nowhere/a.rrd"]', "there is no folder nowhere"),
        (
            '[rerun]\ntargets = ["a.rrd", "./a.rrd"]',
            "'a.rrd' and './a.rrd' are the same; remove one",
        ),
        ('[rerun]\ntargets = ["serve", "serve"]', "'serve' and 'serve' are the same; remove one"),
        ('[recorder]\nfolder = "/proc/version/a"', "/proc/version/a: cannot be used"),
        ('[zenoh]\nlisten = ["tcp/127.0.0.1:99999"]', "is not an endpoint"),
        ('[zenoh]\nlisten = ["tcp/127.0.0.1:7450x"]', "is not an endpoint"),
        ('[zenoh]\nconnect = ["tpc/127.0.0.1:7450"]', "is not an endpoint"),
        ('[zenoh]\nlisten = ["serial//dev/ttyS9"]', "is not an endpoint"),
        ('[zenoh]\nlisten = ["tls/127.0.0.1:7450"]', "to listen with TLS"),
        ('[zenoh]\nconfig_file = "/none.json5"', "/none.json5: cannot be read"),
        ('[zenoh]\nprefix = "/a"', "zenoh prefix '/a': use names"),
        ('[ros2]\nmap_frame_id = "odom"', "'odom' is empty or the name of another frame"),
        ('[zenoh]\nlisten = ["tcp/[::1]:1", "tcp/[::1]:1"]', "has the same endpoint twice"),
        ('[outputs]\nmcap = "a.txt"', "a.txt: the file name must end in .mcap"),
        (
            '[outputs]\nmcap = "/none/a.mcap"',
            "/none/a.mcap: cannot be written: there is no folder /none; create it",
        ),
        ('[outputs]\nextra = ["email"]', "output 'email' is unknown"),
        ('[camera]\nsource = "bag:none.mcap"', "none.mcap: no such file"),
        ("[T_base_camera]\nquaternion_xyzw = [0, 0, 0, 2]", "must have length 1"),
        ("[synthetic]\nduration_s = 0.01", "must hold at least one frame"),
        ("[synthetic.color]\nexposure_s = 0.1", "exceeds a frame"),
        ("[synthetic.timing]\nskew_s = 0.1", "exceeds half a frame"),
        ("[synthetic.color]\ndistortion = [0, 0]", "needs five: k1 k2 p1 p2 k3"),
        ('[synthetic]\ntrack = "none.txt"', "none.txt: cannot be read"),
        ("[odometry]\nmethod = 'orb'", "'orb' is unknown"),
    ],
)
def test_each_error_is_one_line_with_file_line_and_key(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        check_config(config(tmp_path, text))
    dotted = re.sub(r"\[(.*?)\](?s:.*?)(\w+) = [^=]*$", r"\1.\2", text)
    file, line = tmp_path / "kinect.toml", 2 + text.count("\n")
    assert str(caught.value).startswith(f"{file}:{line}: key `{dotted}`: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_error_of_a_later_table_of_a_list_has_its_own_line(tmp_path: Path) -> None:
    fault = '[[synthetic.faults]]\nkind = "unplugged"\nfirst = 1\n'
    with pytest.raises(
        InputError, match=r"toml:6: key `synthetic\.faults\[1\]\.seconds`: seconds must be"
    ):
        check_config(config(tmp_path, f"{fault}seconds = 1\n{fault}"))


def test_an_endpoint_may_have_settings_after_its_port(tmp_path: Path) -> None:
    listen = '["tcp/127.0.0.1:7450?rel=1#iface=lo"]'
    assert check_config(config(tmp_path, f"[zenoh]\nlisten = {listen}")) == []


def test_a_recorder_folder_that_can_be_created_is_valid_and_not_created(tmp_path: Path) -> None:
    folder = tmp_path / "yet" / "to be made"
    assert check_config(config(tmp_path, f'[recorder]\nfolder = "{folder}"')) == []
    assert not folder.parent.exists()


def test_an_endpoint_open_to_the_network_is_a_warning(tmp_path: Path) -> None:
    (warning,) = check_config(config(tmp_path, '[zenoh]\nlisten = ["tcp/0.0.0.0:7450"]'))
    assert "anyone in the network may connect to tcp/0.0.0.0:7450" in warning


def test_a_map_that_cannot_be_loaded_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    file = tmp_path / "maps" / "home.keyframes"
    (warning,) = check_config(config(tmp_path, '[map]\nload = "home"'))
    assert warning.startswith(f"map: {file}: cannot be read: No such file")
    assert check_config(config(tmp_path, '[map]\nload = "home"\nenabled = false')) == []
    (warning,) = check_config(config(tmp_path, '[map]\nload = "home"\nloop_closure = false'))
    assert warning == "map.load: no map is loaded with map.loop_closure = false"


@pytest.mark.subprocess
@pytest.mark.parametrize("name", sorted(file.name for file in ZENOH_FILES.iterdir()))
def test_the_shipped_zenoh_files_are_valid_with_their_keys(
    tmp_path: Path, keys: Path, name: str
) -> None:
    file = make_network(keys, tmp_path).file(name, f"ours/{HOST}")
    assert check_config(config(tmp_path, f'[zenoh]\nconfig_file = "{file}"')) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda text: text.replace('"be read"]', '"be red"]'),
            "Rule 'be red' in policy #0 does not",
        ),
        (lambda text: text.replace('"tls.key"', '"other.key"'), "key values mismatch"),
        (lambda text: text.replace('"tls.pem"', '"robot-tls.json5"'), "give matching PEM files"),
        (lambda text: text.replace("key_exprs", "keys"), "not a Zenoh configuration"),
    ],
)
def test_an_error_in_the_zenoh_file_is_found(
    tmp_path: Path, keys: Path, change: Callable[[str], str], words: str
) -> None:
    network = make_network(keys, tmp_path)
    file = network.file("robot-tls.json5", network.server_identity)
    other = (tmp_path / "ours/reader/tls.key").read_bytes()
    file.with_name("other.key").write_bytes(other)
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError) as caught:
        check_config(config(tmp_path, f'[zenoh]\nconfig_file = "{file}"'))
    assert words in str(caught.value)
    assert str(file) in str(caught.value)


def test_checking_opens_nothing(tmp_path: Path, keys: Path) -> None:
    network = make_network(keys, tmp_path)
    file = network.file("robot-tls.json5", network.server_identity)
    configuration = config(tmp_path, f'[zenoh]\nconfig_file = "{file}"')
    check_config(configuration)  # Zenoh's threads, which it starts once, have files of their own
    before = count_open_files()
    check_config(configuration)
    assert count_open_files() <= before
    assert not is_listening(network.tls_port)
