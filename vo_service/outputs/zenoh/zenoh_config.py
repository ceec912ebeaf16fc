"""Configuration of Zenoh: the user's file, with safe defaults for all else."""

import json
import os
import re
import resource
from pathlib import Path

import zenoh

from drivers.core import InputError
from drivers.core.config import FieldError
from drivers.core.input_files import open_input, read_input_text
from vo_service.config_tables import DEFAULT_ENDPOINT, ZenohConfig

# Keys of a Zenoh configuration that hold file names.
_FILE_KEYS = (
    "transport/link/tls/root_ca_certificate",
    "transport/link/tls/listen_private_key",
    "transport/link/tls/listen_certificate",
    "transport/link/tls/connect_private_key",
    "transport/link/tls/connect_certificate",
    "transport/auth/usrpwd/dictionary_file",
)
# What comes in: poses and commands have a few kilobytes. Zenoh's own limit is a gigabyte.
MAX_MESSAGE_BYTES = 1 << 20
# Largest message of a frame: points of every pixel have 5 MB.
MAX_FRAME_MESSAGE_BYTES = 8 << 20
# Zenoh locks shared memory, at most this much for one publisher.
_LOCKED_BYTES = 8_000_000
_CLIENT_CONNECT_TIMEOUT_MS = 2000
# Zenoh's default waits up to four seconds, for which a client does not see a service that started.
_CONNECT_RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.1}


def read_zenoh_config(path: Path) -> zenoh.Config:
    """Read a Zenoh configuration (JSON5) and make its file names absolute.

    A relative name is searched in systemd's credentials (``$CREDENTIALS_DIRECTORY``), then in the
    folder of the configuration.

    Raises:
        InputError: The configuration or one of its files cannot be read.
    """
    try:
        settings = zenoh.Config.from_json5(read_input_text(path, "name a JSON5 file"))
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
        open_input(file).close()
    except OSError as error:
        searched = " or ".join(dict.fromkeys(str(path.parent) for path in candidates))
        raise InputError(
            f"{config}: {key.replace('/', '.')} = {json.dumps(name)}: {error.strerror} in "
            f"{searched}; put a file there that this user may read, or create it with kinect-vo "
            "certificates"
        ) from error
    return file


def _may_lock_memory() -> bool:
    """Whether this process may map a publisher's pool; if not, it would receive no images."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return limit == resource.RLIM_INFINITY or limit >= _LOCKED_BYTES


def build_zenoh_config(
    config: ZenohConfig, max_message_bytes: int = MAX_MESSAGE_BYTES
) -> zenoh.Config:
    """Build Zenoh's configuration: the file's settings, with safe defaults for all others.

    Zenoh's own defaults listen on every interface and accept any session of the network. Shared
    memory is only for payloads that are placed in it.

    Raises:
        InputError: An endpoint or the configuration file is invalid.
    """
    zenoh_default = zenoh.Config()
    settings = read_zenoh_config(config.config_file) if config.config_file else zenoh.Config()
    ours: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": list(config.listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(config.connect),
        "connect/retry": _CONNECT_RETRY,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": _may_lock_memory(),
        "transport/shared_memory/transport_optimization/enabled": False,
        "timestamping/enabled": True,  # for the caches of latched publishers
        # A whole raw image fits into the queue, so that only a slow reader loses it.
        "transport/link/tx/queue/size/background": 16,
        "transport/link/rx/max_message_size": max_message_bytes,
        # Zenoh's default of two loses poses now and then if many are sent at once.
        "transport/link/tx/queue/size/real_time": 16,
    }
    for key, value in ours.items():
        if settings.get_json(key) == zenoh_default.get_json(key):
            _set_value(settings, key, value)
    if settings.get_json("mode") == '"client"':
        # A client waits for its router while it opens; the default waits forever.
        settings.insert_json5("connect/timeout_ms", json.dumps(_CLIENT_CONNECT_TIMEOUT_MS))
    return settings


def _set_value(settings: zenoh.Config, key: str, value: object) -> None:
    try:
        settings.insert_json5(key, json.dumps(value))
    except zenoh.ZError:
        # Zenoh's error names its own source files.
        name = key.split("/")[0]
        text = str(endpoint_error(f"zenoh.{name} = {json.dumps(value)}"))
        raise FieldError(("zenoh", name), text) from None


def endpoint_error(setting: str) -> InputError:
    """Make the error of a setting that is not an endpoint."""
    return InputError(
        f"{setting}: an endpoint is written PROTOCOL/ADDRESS:PORT, such as {DEFAULT_ENDPOINT}"
    )
