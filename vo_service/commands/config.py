"""``kinect-vo config check``: whether a configuration file is right, before anyone relies on it."""

import argparse
from pathlib import Path

from vo_service.config import read_config

NAME = "config"
HELP = "check a configuration file"
EPILOG = """\
examples:
  kinect-vo config check /etc/kinect-vo/kinect.toml

A mistake is named with its file, line and key; the exit code is then 2.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    check = actions.add_parser("check", help="read a file and say what is wrong with it")
    check.add_argument("file", metavar="FILE", type=Path, help="configuration file (TOML)")


def run(args: argparse.Namespace) -> int:
    """Read the file; any mistake is an InputError."""
    read_config(args.file)
    print(f"{args.file}: no mistakes")
    return 0
