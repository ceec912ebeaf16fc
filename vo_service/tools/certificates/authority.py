"""Certificate authority in a folder: it signs certificates and never overwrites a key."""

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
    """Folder with ca.pem and ca.key, and for each name a folder with ca.pem, tls.pem and tls.key.

    Only this user can read them: folders have mode 0700, files 0600. All methods raise InputError
    for an invalid or used name, and UserFacingError if `openssl` or the disk fails.
    """

    folder: Path

    def check_names_free(self, names: Sequence[str]) -> None:
        """Raise InputError if a name is invalid, repeated or already has a certificate."""
        for count, name in enumerate(names):
            folder = self.folder / check_name(name)
            if folder.exists() or name in names[:count]:
                raise InputError(
                    f"{folder} already exists, and keys are never overwritten; use another name, "
                    "or move that folder away"
                )

    def issue_server_certificate(self, hosts: Sequence[str], days: int) -> Path:
        """Issue a certificate for a computer with these host names and addresses.

        Returns:
            The new folder, named after the first host.
        """
        names = ",".join(_alternative_name(host) for host in hosts)
        return self._issue(hosts[0], _SERVER_EXTENSIONS.format(names), days)

    def issue_client_certificate(self, name: str, days: int) -> Path:
        """Issue a certificate for a client with this common name; returns its folder."""
        return self._issue(name, _CLIENT_EXTENSIONS, days)

    def _issue(self, name: str, extensions: str, days: int) -> Path:
        self.check_names_free([name])
        folder = self.folder / name
        with _private_files(self.folder):
            self._ensure_authority()
            temporary = Path(tempfile.mkdtemp(prefix=".making-", dir=self.folder))
            try:
                create_key(temporary / "tls.key")
                sign_certificate(temporary, self.folder, name, extensions, days)
                shutil.copyfile(self.folder / "ca.pem", temporary / "ca.pem")
                temporary.rename(folder)
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
        return folder

    def _ensure_authority(self) -> None:
        """Create the authority's key and certificate if they do not exist."""
        key, certificate = self.folder / "ca.key", self.folder / "ca.pem"
        if key.exists() and certificate.exists():
            return
        if self.folder.exists() and any(self.folder.iterdir()):
            raise InputError(
                f"{self.folder} has other files but not ca.pem and ca.key; name a new folder"
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        self.folder.chmod(0o700)
        create_key(key)
        create_authority_certificate(key, certificate, _AUTHORITY_NAME, AUTHORITY_DAYS)


def check_name(name: str) -> str:
    """Return `name`.

    Raises:
        InputError: Unless it is valid as a common name and a folder name.
    """
    if not _NAME.fullmatch(name) or name in ("ca.key", "ca.pem"):
        raise InputError(
            f"{name!r} is not a valid certificate name; "
            "use up to 63 letters, digits, '_', '-' and '.'"
        )
    return name


def _alternative_name(host: str) -> str:
    """Return the host in the form of openssl's `subjectAltName`."""
    try:
        return f"IP:{ipaddress.ip_address(host)}"
    except ValueError:
        return f"DNS:{check_name(host)}"


@contextmanager
def _private_files(folder: Path) -> Iterator[None]:
    """Make the block's new files readable by this user only, and report disk errors in one line."""
    before = os.umask(0o077)
    try:
        yield
    except OSError as error:
        raise UserFacingError(
            f"{error.filename or folder}: {error.strerror}; name a writable folder"
        ) from error
    finally:
        os.umask(before)
