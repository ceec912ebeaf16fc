"""``kinect-vo router``: run a small Zenoh router, for a fleet without `zenohd`."""

from dataclasses import dataclass
from pathlib import Path

import zenoh

from drivers.core import InputError
from vo_service.cli.options import print_message
from vo_service.cli.request import CommandRequest, argument
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.addresses import configured_endpoints
from vo_service.outputs.zenoh.session import log_connections, open_session
from vo_service.outputs.zenoh.zenoh_config import build_zenoh_config
from vo_service.signals import stop_on_signals

EPILOG = """\
examples:
  kinect-vo router /etc/kinect-vo/fleet-router.json5
  kinect-vo router fleet-router.json5 --verbose      logs connections

FILE is a Zenoh configuration, such as config/zenoh/fleet-router.json5. Zenoh's own router, zenohd,
reads the same file: zenohd -c fleet-router.json5, in the folder of the file and its keys.
"""

_POLL_PERIOD_S = 0.2


@dataclass(frozen=True, kw_only=True)
class RouterRequest(CommandRequest):
    """The configuration of the router."""

    file: Path = argument("Zenoh configuration (JSON5)", "FILE")


def run(request: RouterRequest) -> int:
    """Route until stopped."""
    config = ZenohConfig(config_file=request.file, listen=())
    settings = build_zenoh_config(config)
    if settings.get_json("mode") != '"router"':
        raise InputError(f'{request.file}: not a router\'s configuration; set mode: "router" in it')
    zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
    with stop_on_signals() as stop, open_session(config) as session:
        log_connections(session)
        endpoints = ", ".join(configured_endpoints(settings, "listen"))
        print_message(f"router: listening at {endpoints} (Ctrl-C ends)")
        # Wait with a timeout: the kernel may deliver the signal to one of Zenoh's threads, which
        # does not wake this one.
        while not stop.event.wait(_POLL_PERIOD_S):
            pass
    return 0
