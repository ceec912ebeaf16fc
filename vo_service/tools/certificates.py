"""Certificate authority in a folder, by the command `openssl`. It never overwrites a key."""

import ipaddress
import os
import re
import secrets
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.core import InputError, UserFacingError
from drivers.core.files import atomic_write
from drivers.core.write_errors import writing

# Zenoh reads elliptic-curve keys in PKCS#8, which is what `genpkey` writes.
_NEW_KEY_ARGUMENTS = ("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256")
AUTHORITY_DAYS = 3650
_AUTHORITY_NAME = "kinect-vo test network"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,62}")
_CLIENT_EXTENSIONS = "basicConstraints=critical,CA:FALSE\nextendedKeyUsage=clientAuth\n"
_SERVER_EXTENSIONS = (
    "basicConstraints=critical,CA:FALSE\nextendedKeyUsage=serverAuth\nsubjectAltName={}\n"
)


def _create_key(file: Path) -> None:
    """Write a new private key. The caller's umask sets who can read it."""
    atomic_write(file, _run_openssl(*_NEW_KEY_ARGUMENTS))


def _create_authority_certificate(key: Path, certificate: Path) -> None:
    """Write a self-signed certificate with which `key` can sign others, but no sub-authorities."""
    data = _run_openssl(
        *("req", "-x509", "-new", "-key", str(key), "-set_serial", _random_serial()),
        *("-subj", f"/CN={_AUTHORITY_NAME}", "-days", str(AUTHORITY_DAYS)),
        *("-addext", "basicConstraints=critical,CA:TRUE,pathlen:0"),
        *("-addext", "keyUsage=critical,keyCertSign,cRLSign"),
    )
    atomic_write(certificate, data)


def _sign_certificate(folder: Path, authority: Path, name: str, extensions: str, days: int) -> None:
    """Sign tls.key in `folder` with ca.key in `authority`, and write tls.pem to `folder`.

    Args:
        extensions: Section of an openssl configuration, one ``key=value`` per line.
    """
    extension_file = folder / "extensions"
    atomic_write(extension_file, extensions.encode())
    request = _run_openssl("req", "-new", "-key", str(folder / "tls.key"), "-subj", f"/CN={name}")
    certificate = _run_openssl(
        *("x509", "-req", "-CA", str(authority / "ca.pem"), "-CAkey", str(authority / "ca.key")),
        *("-days", str(days), "-set_serial", _random_serial(), "-extfile", str(extension_file)),
        standard_input=request,
    )
    atomic_write(folder / "tls.pem", certificate)
    extension_file.unlink()


def _random_serial() -> str:
    return f"0x{secrets.token_hex(16)}"


def _run_openssl(*arguments: str, standard_input: bytes = b"") -> bytes:
    """Run openssl and return its output. Raises UserFacingError with its error output."""
    program = shutil.which("openssl")
    if program is None:
        raise UserFacingError(
            "the command openssl is not installed; run: sudo apt-get install openssl"
        )
    command = [program, *arguments]
    process = subprocess.run(command, input=standard_input, capture_output=True, check=False)
    if process.returncode:
        message = " ".join(process.stderr.decode(errors="replace").split())
        raise UserFacingError(f"openssl {arguments[0]} failed: {message}; fix this and re-run")
    return process.stdout


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
            if name in names[:count]:
                raise InputError(f"{name} is given twice; each certificate needs a name of its own")
            if folder.exists():
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
        with _private_files():
            self._ensure_authority()
            with writing(folder):
                temporary = Path(tempfile.mkdtemp(prefix=".making-", dir=self.folder))
                try:
                    _create_key(temporary / "tls.key")
                    _sign_certificate(temporary, self.folder, name, extensions, days)
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
        is_new = not self.folder.exists()
        with writing(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            self.folder.chmod(0o700)
        try:
            _create_key(key)
            _create_authority_certificate(key, certificate)
        except BaseException:  # a key without its certificate would be in the way
            with suppress(OSError):
                key.unlink(missing_ok=True)
                if is_new:
                    self.folder.rmdir()
            raise


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
def _private_files() -> Iterator[None]:
    """Make the block's new files readable by this user only."""
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)
