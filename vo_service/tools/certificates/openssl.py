"""Keys and certificates made by the `openssl` command."""

import secrets
import shutil
import subprocess
from pathlib import Path

from drivers.core.errors import UserFacingError

# Zenoh reads elliptic-curve keys in PKCS#8, which is what `genpkey` writes.
_NEW_KEY_ARGUMENTS = ("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256")


def create_key(file: Path) -> None:
    """Write a new private key. The caller's umask sets who can read it."""
    _run_openssl(*_NEW_KEY_ARGUMENTS, "-out", str(file))


def create_authority_certificate(key: Path, certificate: Path, name: str, days: int) -> None:
    """Write a self-signed certificate with which `key` can sign others, but no sub-authorities."""
    _run_openssl(
        *("req", "-x509", "-new", "-key", str(key), "-out", str(certificate)),
        *("-subj", f"/CN={name}", "-days", str(days), "-set_serial", _random_serial()),
        *("-addext", "basicConstraints=critical,CA:TRUE,pathlen:0"),
        *("-addext", "keyUsage=critical,keyCertSign,cRLSign"),
    )


def sign_certificate(folder: Path, authority: Path, name: str, extensions: str, days: int) -> None:
    """Sign tls.key in `folder` with ca.key in `authority`, and write tls.pem to `folder`.

    Args:
        folder: Folder of the key to certify.
        authority: Folder with ca.pem and ca.key.
        name: Common name of the certificate.
        extensions: Section of an openssl configuration, one ``key=value`` per line.
        days: Days until the certificate expires.
    """
    request, extension_file = folder / "request", folder / "extensions"
    extension_file.write_text(extensions)
    _run_openssl(
        *("req", "-new", "-key", str(folder / "tls.key"), "-out", str(request)),
        *("-subj", f"/CN={name}"),
    )
    _run_openssl(
        *("x509", "-req", "-in", str(request), "-out", str(folder / "tls.pem")),
        *("-CA", str(authority / "ca.pem"), "-CAkey", str(authority / "ca.key")),
        *("-days", str(days), "-set_serial", _random_serial(), "-extfile", str(extension_file)),
    )
    request.unlink()
    extension_file.unlink()


def _random_serial() -> str:
    return f"0x{secrets.token_hex(16)}"


def _run_openssl(*arguments: str) -> None:
    """Run openssl. Raises UserFacingError with its error output."""
    program = shutil.which("openssl")
    if program is None:
        raise UserFacingError(
            "the command openssl is not installed; run: sudo apt-get install openssl"
        )
    process = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if process.returncode:
        message = " ".join(process.stderr.split())
        raise UserFacingError(f"openssl {arguments[0]} failed: {message}; fix this and re-run")
