"""The keys and certificates that a Zenoh configuration names, found where they really are."""

import json
import os
import re
from pathlib import Path

import zenoh

from drivers.core.errors import InputError

# Where a Zenoh configuration names files.
_FILE_KEYS = (
    "transport/link/tls/root_ca_certificate",
    "transport/link/tls/listen_private_key",
    "transport/link/tls/listen_certificate",
    "transport/link/tls/connect_private_key",
    "transport/link/tls/connect_certificate",
    "transport/auth/usrpwd/dictionary_file",
)


def read_zenoh_config(path: Path) -> zenoh.Config:
    """Read a Zenoh configuration (JSON5). Each file that it names becomes an absolute path.

    A relative name is looked for among the credentials that systemd hands to the service
    (``$CREDENTIALS_DIRECTORY``), then in the folder of the configuration. Raises InputError.
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
    """`:LINE: reason` from Zenoh's words; a mistake of syntax is drawn there over several lines."""
    drawn = re.search(r"--> (\d+):\d+.*= (.*)", text, re.DOTALL)
    if drawn:
        return f":{drawn[1]}: not JSON5: {drawn[2].strip()}"
    return f": not a Zenoh configuration: {' '.join(text.split())}"


def _resolve_file(name: str, config: Path, key: str) -> Path:
    """The file itself. Raises InputError unless it is there and may be read."""
    folders = [config.parent.absolute()]
    if credentials := os.environ.get("CREDENTIALS_DIRECTORY"):
        folders.insert(0, Path(credentials))
    candidates = [folder / name for folder in folders]  # the name alone, where it is absolute
    place = next((each for each in candidates if each.exists()), candidates[-1])
    try:
        place.open("rb").close()
    except OSError as error:
        where = " or ".join(dict.fromkeys(str(each.parent) for each in candidates))
        raise InputError(
            f"{config}: {key.replace('/', '.')} = {json.dumps(name)}: {error.strerror} in {where}; "
            "put it there with rights for this user, or make one with kinect-vo certificates"
        ) from error
    return place
