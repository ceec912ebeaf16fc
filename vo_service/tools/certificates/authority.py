"""A folder that is a small certificate authority: it signs, and never writes over a key."""

import ipaddress
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.core.errors import InputError, UserFacingError
from vo_service.tools.certificates.openssl import (
    create_authority_certificate,
    create_key,
    sign_certificate,
)

AUTHORITY_DAYS = 3650
_AUTHORITY_NAME = "kinect-vo test network"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,62}")
_CLIENT_EXTENSIONS = "basicConstraints=critical,CA:FALSE\nextendedKeyUsage=clientAuth\n"
_SERVER_EXTENSIONS = (
    "basicConstraints=critical,CA:FALSE\nextendedKeyUsage=serverAuth\nsubjectAltName={}\n"
)


@dataclass(frozen=True)
class CertificateAuthority:
    """FOLDER with ca.pem and ca.key, and a folder with ca.pem, tls.pem, tls.key for each name.

    The folders are private (0700), the files too (0600). Everything raises InputError for a name
    that is none or taken, UserFacingError where `openssl` or the disk fails.
    """

    folder: Path

    def check_names_free(self, names: Sequence[str]) -> None:
        """Raise InputError unless all these names can be given a certificate."""
        for count, name in enumerate(names):
            folder = self.folder / check_name(name)
            if folder.exists() or name in names[:count]:
                raise InputError(
                    f"{folder} is there already, and no key is ever written over; take another "
                    "name, or move that folder away"
                )

    def issue_server_certificate(self, hosts: Sequence[str], days: int) -> Path:
        """A certificate for a computer that goes by these names and addresses.

        Its folder is named after the first.
        """
        names = ",".join(_alternative_name(host) for host in hosts)
        return self._issue(hosts[0], _SERVER_EXTENSIONS.format(names), days)

    def issue_client_certificate(self, name: str, days: int) -> Path:
        """A certificate for a program that connects; `name` is its common name."""
        return self._issue(name, _CLIENT_EXTENSIONS, days)

    def _issue(self, name: str, extensions: str, days: int) -> Path:
        self.check_names_free([name])
        folder = self.folder / name
        with _private_files(self.folder):
            self._ensure_authority()
            making = Path(tempfile.mkdtemp(prefix=".making-", dir=self.folder))
            try:
                create_key(making / "tls.key")
                sign_certificate(making, self.folder, name, extensions, days)
                shutil.copyfile(self.folder / "ca.pem", making / "ca.pem")
                making.rename(folder)
            finally:
                shutil.rmtree(making, ignore_errors=True)
        return folder

    def _ensure_authority(self) -> None:
        """Make the authority itself, unless it is there."""
        key, certificate = self.folder / "ca.key", self.folder / "ca.pem"
        if key.exists() and certificate.exists():
            return
        if self.folder.exists() and any(self.folder.iterdir()):
            raise InputError(
                f"{self.folder} holds other things but no ca.pem with its ca.key; name a new folder"
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        self.folder.chmod(0o700)
        create_key(key)
        create_authority_certificate(key, certificate, _AUTHORITY_NAME, AUTHORITY_DAYS)


def check_name(name: str) -> str:
    """The name itself. Raises InputError unless it can be a common name and a folder."""
    if not _NAME.fullmatch(name) or name in ("ca.key", "ca.pem"):
        raise InputError(
            f"{name!r} is no name for a certificate: use up to 63 letters, digits, '_', '-', '.'"
        )
    return name


def _alternative_name(host: str) -> str:
    """As openssl writes it in `subjectAltName`."""
    try:
        return f"IP:{ipaddress.ip_address(host)}"
    except ValueError:
        return f"DNS:{check_name(host)}"


@contextmanager
def _private_files(folder: Path) -> Iterator[None]:
    """Whatever is written in the block is for this user alone; the disk's failures in one line."""
    before = os.umask(0o077)
    try:
        yield
    except OSError as error:
        raise UserFacingError(
            f"{error.filename or folder}: {error.strerror}; name a folder that can be written"
        ) from error
    finally:
        os.umask(before)
