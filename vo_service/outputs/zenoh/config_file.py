"""Reader of a Zenoh configuration, which resolves the key and certificate files in it."""

import json
import os
import re
from pathlib import Path

import zenoh

from drivers.core.errors import InputError

# Keys of a Zenoh configuration that hold file names.
_FILE_KEYS = (
    "transport/link/tls/root_ca_certificate",
    "transport/link/tls/listen_private_key",
    "transport/link/tls/listen_certificate",
    "transport/link/tls/connect_private_key",
    "transport/link/tls/connect_certificate",
    "transport/auth/usrpwd/dictionary_file",
)


def read_zenoh_config(path: Path) -> zenoh.Config:
    """Read a Zenoh configuration (JSON5) and make its file names absolute.

    A relative name is searched in systemd's credentials (``$CREDENTIALS_DIRECTORY``), then in the
    folder of the configuration.

    Raises:
        InputError: the configuration or one of its files cannot be read.
    """
    try:
        settings = zenoh.Config.from_json5(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        cause = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(
            f"{path}: cannot read the Zenoh configuration: {cause}; name a JSON5 file"
        ) from error
    except zenoh.ZError as error:
        raise InputError(
            f"{path}{_line_and_reason(str(error))}; compare it with the examples in config/zenoh"
        ) from error
    for key in _FILE_KEYS:
        name = json.loads(settings.get_json(key))
        if name:
            settings.insert_json5(key, json.dumps(str(_resolve_file(name, path, key))))
    return settings


def _line_and_reason(text: str) -> str:
    """Extract `:LINE: reason` from Zenoh's message, which spans several lines for syntax errors."""
    syntax_error = re.search(r"--> (\d+):\d+.*= (.*)", text, re.DOTALL)
    if syntax_error:
        return f":{syntax_error[1]}: not JSON5: {syntax_error[2].strip()}"
    return f": not a Zenoh configuration: {' '.join(text.split())}"


def _resolve_file(name: str, config: Path, key: str) -> Path:
    """Return the file's absolute path. Raises InputError unless it is readable."""
    folders = [config.parent.absolute()]
    if credentials := os.environ.get("CREDENTIALS_DIRECTORY"):
        folders.insert(0, Path(credentials))
    candidates = [folder / name for folder in folders]  # `name` itself if it is absolute
    file = next((path for path in candidates if path.exists()), candidates[-1])
    try:
        file.open("rb").close()
    except OSError as error:
        searched = " or ".join(dict.fromkeys(str(path.parent) for path in candidates))
        raise InputError(
            f"{config}: {key.replace('/', '.')} = {json.dumps(name)}: {error.strerror} in "
            f"{searched}; put a file there that this user may read, or create it with kinect-vo "
            "certificates"
        ) from error
    return file
