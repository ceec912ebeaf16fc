"""Options of the commands that talk to a running kinect-vo: where it is."""

import argparse
from pathlib import Path

from vo_service.settings import DEFAULT_ENDPOINT


def add_connection_options(parser: argparse.ArgumentParser) -> None:
    """--connect, --prefix and --config-file."""
    parser.add_argument(
        "--connect", metavar="ENDPOINT", default=DEFAULT_ENDPOINT,
        help="where it publishes (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--prefix", default="kinect", help="its zenoh prefix (default: %(default)s)"
    )
    parser.add_argument(
        "--config-file", metavar="ZENOH.json5", type=Path,
        help="a Zenoh configuration: for TLS, and instead of --connect where it says where",
    )  # fmt: skip
