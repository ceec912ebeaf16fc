"""The `openssl` command: what it is asked to do, and what it says when it cannot."""

import secrets
import shutil
import subprocess
from pathlib import Path

from drivers.core.errors import UserFacingError

# Zenoh reads elliptic-curve keys in PKCS#8, which is what `genpkey` writes.
_NEW_KEY_ARGUMENTS = ("genpkey", "-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256")


def create_key(file: Path) -> None:
    """Write a new private key. The caller's umask decides who may read it."""
    _run_openssl(*_NEW_KEY_ARGUMENTS, "-out", str(file))


def create_authority_certificate(key: Path, certificate: Path, name: str, days: int) -> None:
    """Write a certificate by which `key` may sign others', but no further authorities."""
    _run_openssl(
        *("req", "-x509", "-new", "-key", str(key), "-out", str(certificate)),
        *("-subj", f"/CN={name}", "-days", str(days), "-set_serial", _random_serial()),
        *("-addext", "basicConstraints=critical,CA:TRUE,pathlen:0"),
        *("-addext", "keyUsage=critical,keyCertSign,cRLSign"),
    )


def sign_certificate(folder: Path, authority: Path, name: str, extensions: str, days: int) -> None:
    """Have ca.key in `authority` certify tls.key in `folder`; writes tls.pem beside it.

    `extensions` is a section of an openssl configuration, one ``key=value`` a line.
    """
    request, about = folder / "request", folder / "extensions"
    about.write_text(extensions)
    _run_openssl(
        *("req", "-new", "-key", str(folder / "tls.key"), "-out", str(request)),
        *("-subj", f"/CN={name}"),
    )
    _run_openssl(
        *("x509", "-req", "-in", str(request), "-out", str(folder / "tls.pem")),
        *("-CA", str(authority / "ca.pem"), "-CAkey", str(authority / "ca.key")),
        *("-days", str(days), "-set_serial", _random_serial(), "-extfile", str(about)),
    )
    request.unlink()
    about.unlink()


def _random_serial() -> str:
    return f"0x{secrets.token_hex(16)}"


def _run_openssl(*arguments: str) -> None:
    """Raises UserFacingError with what it said."""
    program = shutil.which("openssl")
    if program is None:
        raise UserFacingError(
            "certificates are made by the command openssl, which is not installed: "
            "sudo apt-get install openssl"
        )
    done = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        said = " ".join(done.stderr.split())
        raise UserFacingError(f"openssl {arguments[0]} failed: {said}; mend that and run again")
