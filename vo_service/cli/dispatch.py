"""The command line: ``kinect-vo COMMAND ...``. Each command is a file in `vo_service.cli`."""

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version
from types import ModuleType
from typing import NoReturn

from drivers.core.errors import UserFacingError
from drivers.core.files import kernel_folder
from drivers.core.memory import limit_malloc_arenas
from vo_service.logs import log_to_stderr
from vo_service.signals import EXIT_CODE_SIGINT
from vo_service.terminal import clear_line

COMMANDS = (
    "demo",
    "replay",
    "run",
    "record",
    "calibrate",
    "listen",
    "command",
    "router",
    "certificates",
    "evaluate",
    "reconstruct",
    "compare",
    "bench",
    "download",
    "warm-up",
    "config",
    "udev",
    "service",
    "doctor",
    "devices",
)

EPILOG = """\
examples:
  kinect-vo demo                                        try it without a camera
  kinect-vo replay recordings/desk --trajectory desk.txt
  kinect-vo run --camera synthetic                      as a service, until Ctrl-C
  kinect-vo listen                                      prints its poses, in another terminal

exit codes: 0 success; 1 failed while running; 2 wrong input (an argument, a file, a key); 130 or
143 stopped by Ctrl-C or SIGTERM, with the results so far.
"""


class _OneLineErrorParser(argparse.ArgumentParser):
    """Says what is wrong with an argument in one line, as every other mistake."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"kinect-vo: error: {message}; see `{self.prog} --help`\n")


def run_command(arguments: Sequence[str]) -> NoReturn:
    """Run the command with these arguments; never returns."""
    _reopen_closed_streams()
    try:
        with log_to_stderr():
            sys.exit(_run_reporting_errors(arguments))
    except KeyboardInterrupt:
        sys.exit(EXIT_CODE_SIGINT)
    finally:
        clear_line(sys.stderr)


def _run_reporting_errors(arguments: Sequence[str]) -> int:
    """The command's exit code; a user's mistake becomes one line."""
    try:
        code = _parse_and_run(arguments)
        sys.stdout.flush()  # here, where a reader that has gone can be told from a failure
        return code
    except UserFacingError as error:
        logging.getLogger("kinect-vo").error("%s", error)
        return error.exit_code
    except BrokenPipeError:
        _discard_buffered_output()
        return 0
    except OSError as error:
        # Files have their own messages: this is the disk that standard output goes to.
        where = error.filename or "standard output"
        logging.getLogger("kinect-vo").error(
            "%s: %s; mend that and run again", where, error.strerror
        )
        _discard_buffered_output()
        return 1


def _parse_and_run(arguments: Sequence[str]) -> int:
    """Run what is asked for. Raises UserFacingError, and OSError where output cannot go."""
    _set_library_environment()
    try:
        args = _make_parser(arguments).parse_args(arguments)
    except SystemExit as end:  # after --help, --version, or a mistake that has been told
        return int(end.code or 0)
    if args.verbose:
        logging.getLogger().setLevel(logging.INFO)
    command: ModuleType = args.command
    code: int = command.run(args)
    return code


def _reopen_closed_streams() -> None:
    """Started without standard streams (``>&-``), their numbers would go to any file opened next.

    A driver's process would then write into that file what it means for standard output.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))


def _discard_buffered_output() -> None:
    """Whoever read our output has gone (``| head``): Python's flush at exit must not complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _make_parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Parser for all commands; only the one that is asked for is imported, if one is."""
    parser = _OneLineErrorParser(
        prog="kinect-vo",
        description="Visual odometry for RGB-D cameras: poses over Zenoh, pictures in Rerun.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kinect-vo {version('kinect-vo')}")
    parser.set_defaults(verbose=False)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    asked = [name for name in COMMANDS if name in arguments[:1]]
    for name in asked or COMMANDS:
        module = importlib.import_module(f"vo_service.cli.{name.replace('-', '_')}")
        sub = commands.add_parser(
            name,
            help=module.HELP,
            description=f"{module.HELP[0].upper()}{module.HELP[1:]}.",
            epilog=module.EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(sub)
        sub.add_argument("--verbose", action="store_true", help="log what goes on, to stderr")
        sub.set_defaults(command=module)
    return parser


def _set_library_environment() -> None:
    """Settings that numeric libraries read when they are imported: before any of them is."""
    limit_malloc_arenas()
    # One thread each: a frame is too small to share, and idle threads spin on the other core.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    if "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())
    # OpenCV prints what it makes of a broken image; our own line names the file.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
