"""The command line: ``kinect-vo COMMAND ...``. Each command is a file in `vo_service.cli`."""

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn, TextIO, cast, get_type_hints

from drivers.core import UserFacingError
from drivers.core.folders import kernel_folder, prebuilt_kernels
from drivers.core.processor import use_carried_kernels
from vo_service.cli.request import CommandRequest, add_options, make_request
from vo_service.signals import EXIT_CODE_SIGINT, InterruptedBySignal
from vo_service.terminal import clear_line, log_to_stderr, one_line

# Each command by who needs it, and what it does. Its module is imported only when it is used.
COMMAND_GROUPS = {
    "first steps": {
        "demo": "run the odometry on the virtual Kinect for 10 seconds and show the results",
        "doctor": "check the sensor and this computer, and print how to fix each fault",
        "devices": "list the connected sensors, with the --camera value of each",
    },
    "on a robot": {
        "run": "run the odometry as a service, until Ctrl-C or SIGTERM",
        "service": "install this program as a systemd service, or uninstall it",
        "udev": "install, show or remove the rules that let a sensor be opened without root",
        "config": "check a configuration file, or list all its keys",
        "calibrate": "make a camera file from views of a printed board, or measure its timing",
        "warm-up": "compile and cache the numeric kernels, so that the next start is quick",
    },
    "with a running service": {
        "listen": "print the poses that a running kinect-vo publishes",
        "ros2": "start the ROS 2 node: poses, images, services and diagnostics in ROS",
        "command": "send a command to a running kinect-vo: reset, pause, tilt, record or save",
        "certificates": "make keys and certificates for a test network",
        "router": "run a small Zenoh router for several robots, until Ctrl-C or SIGTERM",
    },
    "recordings": {
        "record": "record any camera into a folder in TUM format, or an MCAP file",
        "replay": "run the odometry over a recording: a folder in TUM format, MCAP or a ROS bag",
        "convert": "write a recording in another format: a folder, MCAP, or a ROS 1 or ROS 2 bag",
        "evaluate": "compare a trajectory with its ground truth: ATE, RPE, coverage",
        "reconstruct": "make a colored mesh from a recording",
        "grid": "make the occupancy grid of a recording, for a robot that drives",
        "download": "download sequences of the TUM RGB-D benchmark, ready to replay",
    },
    "research": {
        "compare": "compare methods and other packages on recordings: accuracy, robustness, cost",
    },
}
COMMANDS = {name: purpose for group in COMMAND_GROUPS.values() for name, purpose in group.items()}

EPILOG = """\
examples:
  kinect-vo demo                                        try it without a camera
  kinect-vo replay recordings/desk --trajectory desk.txt
  kinect-vo run --camera synthetic                      as a service, until Ctrl-C
  kinect-vo listen                                      prints its poses, in another terminal

exit codes: 0 success; 1 failed while running; 2 wrong input (an argument, a file, a key); 130, 143
or 129 stopped by Ctrl-C, SIGTERM or the end of the terminal, with the results so far.
"""


class _OneLineErrorParser(argparse.ArgumentParser):
    """Reports a wrong argument in one line, like every other mistake."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"kinect-vo: error: {one_line(message)}; see `{self.prog} --help`\n")


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Run the command of these arguments, or of the process's; never returns."""
    _reopen_closed_streams()
    try:
        with log_to_stderr(), redirect_stdout(cast(TextIO, _NamedStandardOutput(sys.stdout))):
            sys.exit(_run_reporting_errors(sys.argv[1:] if argv is None else argv))
    except InterruptedBySignal as interruption:
        sys.exit(interruption.exit_code)
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
        logging.getLogger("kinect-vo").error("%s", one_line(str(error)))
        return error.exit_code
    except BrokenPipeError:
        _discard_buffered_output()
        return 0
    except OSError as error:
        name = error.filename or ("" if _has_current_folder() else "the current folder")
        where = f"{name}: " if name else ""
        logging.getLogger("kinect-vo").error(
            "%s; fix this and run again", one_line(f"{where}{error.strerror or error}")
        )
        _discard_buffered_output()
        return 1


def _has_current_folder() -> bool:
    """Whether the current folder still exists: names of files need it."""
    try:
        Path.cwd()
    except FileNotFoundError:
        return False
    return True


class _NamedStandardOutput:
    """Standard output that is named in its errors, as files are."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with _naming_standard_output():
            try:
                return self._stream.write(text)
            except UnicodeEncodeError:  # the terminal's encoding lacks a character of a path
                return self._stream.write(_escape(text, self._stream.encoding))

    def flush(self) -> None:
        with _naming_standard_output():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _escape(text: str, encoding: str) -> str:
    """Escape the characters that an encoding lacks."""
    return text.encode(encoding, errors="backslashreplace").decode(encoding)


@contextmanager
def _naming_standard_output() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        error.filename = "standard output"
        raise


def _parse_and_run(arguments: Sequence[str]) -> int:
    """Parse the arguments and run the command.

    Raises:
        UserFacingError: If the command fails; an InputError if its input is wrong.
        OSError: If standard output cannot be written, or a file be read.
    """
    set_library_environment()
    try:
        args = make_parser(arguments[:1]).parse_args(arguments)
    except SystemExit as end:  # after --help, --version, or a reported mistake
        return int(end.code or 0)
    if args.verbose:
        logging.getLogger().setLevel(logging.INFO)
    command: ModuleType = args.command
    code: int = command.run(make_request(args.request, args))
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


def make_parser(with_options: Collection[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """Make the parser of all commands; the modules of some are imported, for their options."""
    parser = _OneLineErrorParser(
        prog="kinect-vo",
        usage="kinect-vo [-h] [--version] COMMAND ...",
        description="Visual odometry for RGB-D cameras: poses over Zenoh, images in Rerun.",
        epilog=f"{_list_commands()}\n{EPILOG}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"kinect-vo {version('kinect-vo')}")
    parser.set_defaults(verbose=False)
    commands = parser.add_subparsers(
        prog="kinect-vo", metavar="COMMAND", required=True, help=argparse.SUPPRESS
    )
    for name, purpose in COMMANDS.items():
        if name in with_options:
            _add_command(commands, name)
        else:
            commands.add_parser(name, help=purpose)
    return parser


def _list_commands() -> str:
    """List the commands by group, in columns."""
    width = max(map(len, COMMANDS))
    return "\n".join(
        f"{title}:\n" + "".join(f"  {name:{width}}  {purpose}\n" for name, purpose in group.items())
        for title, group in COMMAND_GROUPS.items()
    )


def _add_command(commands: "argparse._SubParsersAction[_OneLineErrorParser]", name: str) -> None:
    """Import the module of a command and declare its options."""
    module = importlib.import_module(f"vo_service.cli.{name.replace('-', '_')}")
    purpose = COMMANDS[name]
    parser = commands.add_parser(
        name,
        help=purpose,
        description=f"{purpose[0].upper()}{purpose[1:]}.",
        epilog=module.EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if hasattr(module, "ACTIONS"):
        _add_actions(parser, module.ACTIONS)
    else:
        _set_request(parser, get_type_hints(module.run)["request"])
    parser.add_argument("--verbose", action="store_true", help="log progress to stderr")
    parser.set_defaults(command=module)


def _add_actions(
    parser: argparse.ArgumentParser, requests: Mapping[str, type[CommandRequest]]
) -> None:
    """Add the actions of a command; the docstrings of their requests are the help texts."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    for name, request in requests.items():
        purpose = (request.__doc__ or "").rstrip(".")
        action = actions.add_parser(name, help=f"{purpose[0].lower()}{purpose[1:]}")
        _set_request(action, request)


def _set_request(parser: argparse.ArgumentParser, request: type[CommandRequest]) -> None:
    add_options(parser, request)
    parser.set_defaults(request=request)


def set_library_environment() -> None:
    """Set the variables that numeric libraries read at import."""
    # One thread each: a frame is too small for more, and idle threads spin on the other core.
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    use_carried_kernels(prebuilt_kernels())
    if "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder())
    # Without OpenCV's own line about a broken image: our error message names the file.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
