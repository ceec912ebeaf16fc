"""Keys and certificates for Zenoh: private, and never overwritten."""

import re
import stat
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core import InputError, UserFacingError
from vo_service.tools.certificates import CertificateAuthority, check_name

pytestmark = pytest.mark.subprocess


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> CertificateAuthority:
    """Authority with a server and a client; tests may add other names."""
    authority = CertificateAuthority(tmp_path_factory.mktemp("keys"))
    authority.issue_server_certificate(["robot1.local", "192.168.1.20", "::1"], 30)
    authority.issue_client_certificate("reader", 30)
    return authority


def run_openssl(*arguments: str) -> str:
    process = subprocess.run(["openssl", *arguments], capture_output=True, text=True, check=True)
    return process.stdout


def text_of(certificate: Path) -> str:
    return run_openssl("x509", "-in", str(certificate), "-noout", "-text")


def test_each_name_gets_the_three_files_to_copy_which_the_authority_verifies(
    authority: CertificateAuthority,
) -> None:
    authority.issue_client_certificate("later", 30)
    for name in ("robot1.local", "reader", "later"):
        folder = authority.folder / name
        assert {file.name for file in folder.iterdir()} == {"ca.pem", "tls.pem", "tls.key"}
        run_openssl("verify", "-CAfile", str(folder / "ca.pem"), str(folder / "tls.pem"))


def test_a_server_is_known_by_all_its_names(authority: CertificateAuthority) -> None:
    text = text_of(authority.folder / "robot1.local" / "tls.pem")
    assert "DNS:robot1.local, IP Address:192.168.1.20" in text
    assert "TLS Web Server Authentication" in text
    assert "Client Authentication" not in text


def test_a_client_is_known_by_its_common_name(authority: CertificateAuthority) -> None:
    text = text_of(authority.folder / "reader" / "tls.pem")
    assert re.search(r"Subject: CN ?= ?reader\b", text)
    assert "TLS Web Client Authentication" in text
    assert "CA:FALSE" in text


def test_keys_are_elliptic_and_in_pkcs8(authority: CertificateAuthority) -> None:
    key = (authority.folder / "reader" / "tls.key").read_text()
    assert key.startswith("-----BEGIN PRIVATE KEY-----")
    assert "prime256v1" in run_openssl(
        "ec", "-in", str(authority.folder / "reader/tls.key"), "-text"
    )


def test_other_users_cannot_read_the_keys(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    CertificateAuthority(folder).issue_client_certificate("reader", 30)
    for path in [folder, *folder.rglob("*")]:
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_they_last_as_long_as_asked(authority: CertificateAuthority) -> None:
    folder = authority.issue_client_certificate("short", 1)
    certificate = str(folder / "tls.pem")
    run_openssl("x509", "-in", certificate, "-noout", "-checkend", "3600")
    with pytest.raises(subprocess.CalledProcessError):
        run_openssl("x509", "-in", certificate, "-noout", "-checkend", str(25 * 3600))


def test_a_key_is_never_overwritten(authority: CertificateAuthority) -> None:
    key = authority.folder / "reader" / "tls.key"
    before = key.read_bytes()
    with pytest.raises(InputError, match="already exists"):
        authority.issue_client_certificate("reader", 30)
    assert key.read_bytes() == before


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("important")
    with pytest.raises(InputError, match="name a new folder"):
        CertificateAuthority(tmp_path).issue_client_certificate("reader", 30)
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.txt"]


def test_nothing_is_left_of_a_certificate_that_failed(tmp_path: Path) -> None:
    authority = CertificateAuthority(tmp_path / "keys")
    authority.issue_client_certificate("reader", 30)
    (authority.folder / "ca.key").write_text("damaged")
    with pytest.raises(UserFacingError, match="openssl x509 failed"):
        authority.issue_client_certificate("late", 30)
    assert {file.name for file in authority.folder.iterdir()} == {"ca.key", "ca.pem", "reader"}


def test_a_missing_openssl_is_reported_with_its_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserFacingError, match="apt-get install openssl"):
        CertificateAuthority(tmp_path / "keys").issue_client_certificate("reader", 30)


@given(st.text(max_size=80))
def test_a_name_stays_a_plain_name_in_the_folder(name: str) -> None:
    with suppress(InputError):
        accepted = check_name(name)
        assert (Path("keys") / accepted).resolve().parent == Path("keys").resolve()
        assert len(accepted) <= 63
