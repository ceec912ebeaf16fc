"""``kinect-vo config``: check a configuration file, or print the configuration reference."""

import argparse
import logging
from collections.abc import Callable
from pathlib import Path

from vo_service.config_check import check_config
from vo_service.config_reference import render_reference

logger = logging.getLogger(__name__)

EPILOG = """\
examples:
  kinect-vo config check /etc/kinect-vo/kinect.toml
  kinect-vo config reference | less

An error names its file, line and key; the exit code is then 2. The check includes the files and
addresses that the configuration names, without opening them: the camera file, Rerun targets, Zenoh
endpoints, and the Zenoh configuration with its keys and rules.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    check = actions.add_parser("check", help="check a file, and the files and addresses in it")
    check.add_argument("file", metavar="FILE", type=Path, help="configuration file (TOML)")
    check.set_defaults(action=_check_file)
    listing = actions.add_parser("reference", help="print every key with its meaning (Markdown)")
    listing.set_defaults(action=_print_reference)


def run(args: argparse.Namespace) -> int:
    """Check or print.

    Raises:
        InputError: For the first mistake in the file.
    """
    action: Callable[[argparse.Namespace], int] = args.action
    return action(args)


def _check_file(args: argparse.Namespace) -> int:
    for warning in check_config(args.file):
        logger.warning("%s", warning)
    print(f"{args.file}: no mistakes")
    return 0


def _print_reference(args: argparse.Namespace) -> int:
    print(render_reference(), end="")
    return 0
