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
    """Reports a wrong argument in one line, like every other mistake."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"kinect-vo: error: {message}; see `{self.prog} --help`\n")


def run_command(arguments: Sequence[str]) -> NoReturn:
    """Run the command of the given arguments; never returns.

    Args:
        arguments: Arguments of the command line, without the program.
    """
    _reopen_closed_streams()
    try:
        with log_to_stderr():
            sys.exit(_run_reporting_errors(arguments))
    except KeyboardInterrupt:
        sys.exit(EXIT_CODE_SIGINT)
    finally:
        clear_line(sys.stderr)


def _run_reporting_errors(arguments: Sequence[str]) -> int:
    """Run the command and return its exit code; report a `UserFacingError` in one line."""
    try:
        code = _parse_and_run(arguments)
        sys.stdout.flush()  # here, so that a closed pipe is not reported as a failure
        return code
    except UserFacingError as error:
        logging.getLogger("kinect-vo").error("%s", error)
        return error.exit_code
    except BrokenPipeError:
        _discard_buffered_output()
        return 0
    except OSError as error:
        # Errors of files have their own messages: this is the disk of standard output.
        where = error.filename or "standard output"
        logging.getLogger("kinect-vo").error(
            "%s: %s; fix this and run again", where, error.strerror
        )
        _discard_buffered_output()
        return 1


def _parse_and_run(arguments: Sequence[str]) -> int:
    """Parse the arguments and run the command.

    Raises:
        UserFacingError: If the command fails.
        OSError: If standard output cannot be written.
    """
    _set_library_environment()
    try:
        args = _make_parser(arguments).parse_args(arguments)
    except SystemExit as end:  # after --help, --version, or a reported mistake
        return int(end.code or 0)
    if args.verbose:
        logging.getLogger().setLevel(logging.INFO)
    command: ModuleType = args.command
    code: int = command.run(args)
    return code


def _reopen_closed_streams() -> None:
    """Open closed standard streams (``>&-``) on /dev/null.

    Otherwise the next file to be opened gets the number of standard output, and a driver's process
    writes its messages into that file.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))


def _discard_buffered_output() -> None:
    """Discard the output after the reader has closed the pipe (``| head``): no error at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _make_parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    """Make the parser of all commands. If one is given, only its module is imported."""
    parser = _OneLineErrorParser(
        prog="kinect-vo",
        description="Visual odometry for RGB-D cameras: poses over Zenoh, images in Rerun.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kinect-vo {version('kinect-vo')}")
    parser.set_defaults(verbose=False)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    requested = [name for name in COMMANDS if name in arguments[:1]]
    for name in requested or COMMANDS:
        module = importlib.import_module(f"vo_service.cli.{name.replace('-', '_')}")
        sub = commands.add_parser(
            name,
            help=module.HELP,
            description=f"{module.HELP[0].upper()}{module.HELP[1:]}.",
            epilog=module.EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(sub)
        sub.add_argument("--verbose", action="store_true", help="log progress to stderr")
        sub.set_defaults(command=module)
    return parser


def _set_library_environment() -> None:
    """Set the variables that numeric libraries read at import."""
    limit_malloc_arenas()
    # One thread each: a frame is too small for more, and idle threads spin on the other core.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    if "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())
    # Without OpenCV's own line about a broken image: our error message names the file.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
